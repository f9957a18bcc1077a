"""The command line: parse, dispatch, print. May import every room, and loads only what the command needs.

Each command is one module with `add_arguments(parser)` and `run(args) -> int`, and `EXAMPLES` below its help. Those in
`SEPARATE` come with distributions of their own, which name the module in an entry point of `echoavatar.commands`. Exit
codes: 0 done, 1 an error the user can mend (one line), 2 wrong usage, 130 interrupted, 141 the reader is gone.
"""

import argparse
import atexit
import gc
import importlib
import io
import logging
import os
import re
import sys
from collections.abc import Collection, Sequence
from importlib.metadata import entry_points
from types import ModuleType

from echoavatar import __version__
from echoavatar.errors import DependencyError, EchoAvatarError, one_line
from echoavatar.whole_file import disk_errors

from . import settings

COMMANDS = {
    "demo": "open a page with a live avatar, or write bundled speech and music as films and models",
    "animate": "turn an audio file into full-body motion (GLB, VRMA, USD, FBX, BVH, MP4, ...)",
    "serve": "serve live avatars to browsers and voice agents",
    "camera": "show a server's avatar as a camera in Zoom, Teams or OBS, or send it to an RTMP server or a file",
    "proxy": "put an avatar behind a voice agent that speaks the OpenAI Realtime protocol",
    "mcp": "offer an avatar's tools to agents over the Model Context Protocol",
    "say": "let the avatar of a running server speak a sound file",
    "elevenlabs": "set up an ElevenLabs agent that moves the avatar",
    "export": "turn a recording into a file for another program, or put it on your own character",
    "play": "play a recording to VMC programs, MetaHumans or your own receiver",
    "completion": "let your shell complete commands and options",
    "doctor": "check what works on this machine, and say how to repair the rest",
    "bench": "measure latency, real-time factor and memory",
    "evaluate": "score a bundle; the last line is JSON",
    "score": "score any motion against recorded motion: every metric with chance level and interval",
    "baseline": "make motion without a model, to compare scores with: mean pose, random clip, nearest sound",
    "reproduce": "reproduce a table of the paper, with the paper's numbers beside ours",
    "data": "make training data",
    "train": "train the codec, the motion tokenizer, the generator, the face, the fingers or FID's extractor",
    "plot": "plot the metrics of one or several training runs",
    "bundle": "assemble trained parts into a bundle",
    "import": "convert the paper authors' published checkpoints into a bundle",
    "pull": "fetch a model from the hub; resumes, and checks hashes",
    "actions": "list the actions an avatar can be asked for; add an action from a clip",
    "tools": "print the avatar's tools for a language model, in the form of its framework",
    "rig": "measure a character's body, so that hands do not pass into it",
    "align": "tune a generator by reinforcement learning: GRPO, DPO, PPO and their rewards",
    "studio": "collect preferences and run user studies in the browser",
    "refine-fingers": "add plausible fingers to motion that was captured without them",
}
SEPARATE = {
    "actions build": "lab",
    "align": "lab",
    "baseline": "lab",
    "bench neighbours": "lab",
    "bench post": "lab",
    "bench soak": "lab",
    "bench train": "lab",
    "bundle": "lab",
    "data": "lab",
    "evaluate": "lab",
    "import": "lab",
    "plot": "lab",
    "pull": "lab",
    "refine-fingers": "lab",
    "reproduce": "lab",
    "score": "lab",
    "serve unity": "lab",
    "studio": "studio",
    "train": "lab",
}  # command -> distribution echoavatar-NAME, folder ./NAME


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    for name in ("stdout", "stderr"):
        if (stream := getattr(sys, name)) is None:  # closed, as by some programs that start others
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a console may lack letters that we or file names use
    if argv is None:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout = Printable(sys.stdout)
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # a search of all installed packages
        atexit.register(gc.freeze)  # else Python's end looks through all objects of the libraries
        gc.set_threshold(200_000, 20, 20)  # no collections while the libraries load
    asked = next((word for word in words if not word.startswith("-")), "")
    try:
        os.getcwd()
    except OSError:  # torch's library would end the process
        os.chdir(os.sep)
        print(f"echoavatar: the current folder is gone; names are taken from {os.sep}", file=sys.stderr)
    try:
        if (separate := " ".join(words[:2])) in SEPARATE:
            command_module(separate)  # raises where it is not installed
        args = build_parser([asked]).parse_args(words)
        if not sys.stderr.isatty():  # a log file would get a line for each step of a bar
            os.environ.setdefault("TQDM_DISABLE", "1")
        handler = logging.StreamHandler()
        handler.setFormatter(LogFormat("%(levelname)s %(name)s: %(message)s"))
        logging.basicConfig(level=logging.WARNING - 10 * args.verbose + 10 * args.quiet, handlers=[handler])
        with disk_errors("the output"):
            code: int = command_module(args.command).run(args)
            sys.stdout.flush()
    except ModuleNotFoundError as error:
        from .doctor import missing_package

        if (missing := missing_package(error)) is None:
            raise
        print(f"echoavatar: this needs {missing[0]}: {missing[1]}", file=sys.stderr)
        code = 1
    except BrokenPipeError:  # the reader of our output has ended, as `head` does
        code = 141
    except EchoAvatarError as error:
        print(f"echoavatar: {one_line(error)}", file=sys.stderr)
        code = 1
    except OSError as error:  # a full disk, an impossible name, no permission: wherever it happens
        _LOG.debug("where it happened", exc_info=True)
        remedy = "; check its name, space and permissions" if error.filename else ""
        if "temporary directory" in str(error):  # Python names the folders that it tried
            remedy = "; set TMPDIR to a folder that can be written"
        print(f"echoavatar: {one_line(error)}{remedy}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt as stop:  # a training run states where it stopped, and the signal that ended it
        print(f"echoavatar: {str(stop) or 'interrupted'}", file=sys.stderr)
        code = int(getattr(stop, "code", 130))
    if code and argv is None:
        gc.collect()  # an error may keep half-read sound, and the resampler's library would complain of it at the end
        _end_output()
    return code


_LOG = logging.getLogger(__name__)
_COMMANDS_A_TERMINAL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def _end_output() -> None:
    """Flush standard output. If that fails, drop the rest, or Python would complain at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def printable(text: str) -> str:
    """Text for a terminal, with control characters as escapes that JSON reads too; line ends stay."""
    return _COMMANDS_A_TERMINAL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


class Printable(io.TextIOWrapper):
    """Standard output on which no file's name or text can move the cursor or colour the terminal."""

    def __init__(self, stream: io.TextIOWrapper) -> None:
        """Takes the place of `stream`, which is closed to further use."""
        encoding, is_terminal = stream.encoding, stream.isatty()
        super().__init__(stream.detach(), encoding=encoding, errors="replace", line_buffering=is_terminal)

    def write(self, text: str) -> int:
        """Write the text as `printable` shows it."""
        super().write(printable(text))
        return len(text)


class LogFormat(logging.Formatter):
    """Lines of the log, which name files too."""

    def format(self, record: logging.LogRecord) -> str:
        """The line as `printable` shows it."""
        return printable(super().format(record))


def build_parser(filled: Collection[str]) -> argparse.ArgumentParser:
    """The parser with all commands; those in `filled` know their arguments. Raises as `command_module`."""
    parser = argparse.ArgumentParser(
        prog="echoavatar",
        description="An audio stream becomes full-body motion, in real time.",
        epilog="`echoavatar COMMAND --help` explains each command with examples. Options may also stand in a file or "
        "in the environment: docs/command_line.md.",
    )
    parser.add_argument("--version", action="version", version=f"echoavatar {__version__}")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("-v", "--verbose", action="count", default=0, help="say more; -vv for everything")
    common.add_argument("-q", "--quiet", action="count", default=0, help="no warnings")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, summary in COMMANDS.items():
        child = commands.add_parser(
            name,
            help=summary,
            description=summary,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            parents=[common],
        )
        if name in filled:
            module = command_module(name)
            child.epilog = getattr(module, "EXAMPLES", None)
            module.add_arguments(child)
            settings.apply(child, name)
    return parser


def command_module(command: str) -> ModuleType:
    """Import the module of a command.

    Raises DependencyError if the command comes with another distribution, which is not installed.
    """
    if command in SEPARATE:
        for entry in entry_points(group="echoavatar.commands", name=command.replace(" ", "-")):
            module: ModuleType = entry.load()
            return module
        name = SEPARATE[command]
        raise DependencyError(
            f"`echoavatar {command}` comes with echoavatar-{name}, which is not installed;"
            f" in a clone of the repository: pip install ./{name}"
        )
    return importlib.import_module(f".{command.replace('-', '_')}", __name__)
