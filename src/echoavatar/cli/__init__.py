"""The command line: parse, dispatch, print. May import every room; imports only the one the command needs.

Each command is one module with `add_arguments(parser)` and `run(args) -> int`. The commands in `SEPARATE` come with
distributions of their own, which name the module in an entry point of the group `echoavatar.commands`. Exit codes:
0 done, 1 an error the user can put right (one line), 2 wrong usage.
"""

import argparse
import importlib
import keyword
import logging
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from types import ModuleType

from ..errors import DependencyError, EchoAvatarError

COMMANDS = {
    "demo": "render bundled speech and music to MP4, GLB and a page that plays them",
    "animate": "turn an audio file into full-body motion (GLB, VRMA, USD, FBX, BVH, MP4, ...)",
    "serve": "serve live avatars to browsers and voice agents",
    "proxy": "put an avatar behind a voice agent that speaks the OpenAI Realtime protocol",
    "mcp": "offer an avatar's tools to agents over the Model Context Protocol",
    "say": "let the avatar of a running server say a sound file",
    "elevenlabs": "set up an ElevenLabs agent that moves the avatar",
    "export": "turn a recording into a file for another program, or put it on your own character",
    "play": "play a recording into VMC programs, MetaHumans or a receiver of yours",
    "doctor": "say what works on this machine and what to do about the rest",
    "bench": "measure latency, real-time factor and memory",
    "evaluate": "score a bundle; the last line is JSON",
    "score": "score any motion against true motion: every metric with chance level and interval",
    "baseline": "motion without a model, to hold scores against: mean pose, random clip, nearest sound",
    "reproduce": "make a table of the paper again, the paper's numbers beside ours",
    "data": "make training data",
    "train": "train the codec, the motion tokenizer, the generator, the face, the fingers or FID's extractor",
    "plot": "draw the metrics of training runs, one or several side by side",
    "bundle": "assemble trained parts into a bundle",
    "import": "make a bundle of the authors' published checkpoints",
    "pull": "fetch a model from the hub, resumed and checked",
    "actions": "list what the avatar can be asked to do; add an action from a clip",
    "tools": "print what a language model may do with the avatar, in its framework's form",
    "rig": "measure a character's body, so that hands keep off it",
    "align": "tune a generator by reinforcement learning: GRPO, DPO, PPO and their rewards",
    "studio": "collect preferences and run user studies in the browser",
    "refine-fingers": "give motion that was captured without fingers plausible ones",
}
SEPARATE = {
    "reproduce": "research",
    "studio": "studio",
}  # command -> distribution echoavatar-NAME, folder ./NAME


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    parser = argparse.ArgumentParser(
        prog="echoavatar",
        description="An audio stream becomes full-body motion, in real time.",
        epilog="`echoavatar COMMAND --help` explains each command with examples.",
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    asked = next((word for word in words if not word.startswith("-")), None)
    try:
        for name, summary in COMMANDS.items():
            child = commands.add_parser(
                name, help=summary, description=summary, formatter_class=argparse.RawDescriptionHelpFormatter
            )
            if name == asked:
                command_module(name).add_arguments(child)
        args = parser.parse_args(words)
        code: int = command_module(args.command).run(args)
    except EchoAvatarError as error:
        print(f"echoavatar: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:  # a training run says where it stopped, and which signal ended it
        print(f"echoavatar: {str(stop) or 'interrupted'}", file=sys.stderr)
        return int(getattr(stop, "code", 130))
    return code


def command_module(command: str) -> ModuleType:
    """Import the module of a command.

    Raises:
        DependencyError: the command comes with another distribution, which is not installed.
    """
    if command in SEPARATE:
        for entry in entry_points(group="echoavatar.commands", name=command):
            module: ModuleType = entry.load()
            return module
        name = SEPARATE[command]
        raise DependencyError(
            f"`echoavatar {command}` comes with echoavatar-{name}, which is not installed;"
            f" in a clone of the repository: pip install ./{name}"
        )
    name = command.replace("-", "_")
    return importlib.import_module(f".{name}_" if keyword.iskeyword(name) else f".{name}", __name__)
