"""`echoavatar pull`: downloads a model from the hub and verifies it."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = (
        "examples:\n"
        "  echoavatar pull facebook/encodec_24khz                    into the local model cache\n"
        "  echoavatar pull OWNER/NAME -o EchoAvatar --only 'ckpts/*' into a folder\n"
        "An interrupted download resumes. Every file is checked against the hub's hash."
    )
    parser.add_argument("name", metavar="NAME", help="OWNER/NAME on the hub")
    parser.add_argument("-o", "--output", type=Path, help="folder (default: the local model cache)")
    parser.add_argument("--revision", help="branch, tag or commit (default: the newest)")
    parser.add_argument("--only", action="append", metavar="PATTERN", help="files, such as 'ckpts/*'; may be repeated")


def run(args: argparse.Namespace) -> int:
    """Download and verify."""
    from echoavatar.hub import pull

    done = pull(args.name, args.output, revision=args.revision, only=args.only)
    print(f"{done.folder}: {done.files} files, {done.checked} checked against the hub's sha256, commit {done.commit}")
    return 0
