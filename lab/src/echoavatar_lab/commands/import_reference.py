"""`echoavatar import reference`: convert the paper authors' published checkpoints into a bundle."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from echoavatar.cli import printable
from echoavatar.errors import CheckpointError, EchoAvatarError

if TYPE_CHECKING:
    from echoavatar.engine.pipeline import ActionLibrary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-commands."""
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)
    reference = kinds.add_parser(
        "reference",
        help="the authors' release",
        description="Check the authors' download and convert it. None of its code is run; everything unfit is listed.",
        epilog=(
            "examples:\n"
            "  echoavatar import reference --ckpts EchoAvatar/ckpts --stats EchoAvatar/stats -o reference --dry-run\n"
            "  echoavatar import reference --ckpts EchoAvatar/ckpts --stats EchoAvatar/stats -o reference\n"
            "  echoavatar serve --model reference\n"
            "From download to avatar: docs/reference.md"
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    reference.add_argument("--ckpts", type=Path, required=True, help="folder with body_rvqvae, face, body_g_d")
    reference.add_argument("--stats", type=Path, required=True, help="folder 'stats' of the authors' repository")
    reference.add_argument("-o", "--output", type=Path, required=True, help="folder of the new bundle")
    reference.add_argument(
        "--generator",
        choices=("body_g", "body_g_d"),
        help="gesture alone, or gesture and dance (default: body_g_d where the download has it)",
    )
    reference.add_argument(
        "--codec",
        default="facebook/encodec_24khz",
        help="EnCodec: a folder, or a name in the local model cache (default: %(default)s)",
    )
    reference.add_argument(
        "--actions", type=Path, help="file with the table of actions (default: the script beside the stats folder)"
    )
    reference.add_argument(
        "--step",
        type=int,
        choices=(2, 3),
        default=2,
        help="motion tokens per step: 2 (paper, 0.27 s) or 3 (release, 0.4 s) (default: %(default)s)",
    )
    reference.add_argument(
        "--face-order",
        choices=("apple", "live_link"),
        default="apple",
        help="order of the face's channels; try the other if jaw and mouth go to the wrong side (default: %(default)s)",
    )
    reference.add_argument("--dry-run", action="store_true", help="print where each tensor would go; write nothing")


def run(args: argparse.Namespace) -> int:
    """Check, print or convert."""
    from echoavatar_lab.models.published import read_encodec
    from echoavatar_lab.reference import Release, convert, inspect_release

    if args.output.exists() and (not args.output.is_dir() or any(args.output.iterdir())):
        raise EchoAvatarError(f"{args.output} exists and is not empty; choose another -o or remove it")
    found = inspect_release(Release(args.ckpts, args.stats), generator=args.generator, step=args.step)
    try:
        actions = _actions(args)
    except CheckpointError as error:
        found.problems.append(str(error))
    problems = list(dict.fromkeys(found.problems))  # several parts may report the same problem
    if args.dry_run:
        for line in found.lines:
            print(f"{line.file}: {line.name} {list(line.shape)} -> {line.target}")
    for problem in problems:
        print(f"problem: {printable(problem)}", file=sys.stderr)
    if problems:
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        raise CheckpointError(f"{count}, listed above; nothing was written")
    if args.dry_run:
        print(f"{len(found.lines)} tensors and tables fit, {len(actions)} actions; nothing was written")
        return 0
    codec = read_encodec(args.codec)
    command = f"echoavatar import reference --step {args.step} --face-order {args.face_order}"
    convert(found, codec, args.output, actions=actions, face_order=args.face_order, command=command)
    from echoavatar_lab.reference.convert import WARNING

    print(f"{args.output}: {len(found.lines)} tensors and tables, {len(actions)} actions\nlicence: {WARNING}")
    return 0


def _actions(args: argparse.Namespace) -> "ActionLibrary":
    from echoavatar.engine.pipeline import ActionLibrary
    from echoavatar.timing import ChunkSize
    from echoavatar_lab.reference.actions import find_table, library, read_table

    path = args.actions or find_table(args.stats)
    if path is None:
        print(
            f"no table of actions beside {args.stats}, so the bundle gets none; --actions takes the authors' script",
            file=sys.stderr,
        )
        return ActionLibrary()
    return library(read_table(path), 512, origin=str(path), chunk=ChunkSize(args.step))
