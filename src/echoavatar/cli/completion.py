"""`echoavatar completion`: a script that lets your shell complete commands, options and file names."""

import argparse
from importlib.metadata import entry_points

EXAMPLES = """examples:
  echoavatar completion bash > ~/.local/share/bash-completion/completions/echoavatar
  echoavatar completion zsh > ~/.zfunc/_echoavatar          (with fpath+=~/.zfunc before compinit)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="your shell")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from . import COMMANDS, SEPARATE, build_parser

    there = [name for name in COMMANDS if name not in SEPARATE or entry_points(group="echoavatar.commands", name=name)]
    print(shtab.complete(build_parser(there), args.shell))
    return 0
