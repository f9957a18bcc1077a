"""Several files of one command: where each output goes, and the result of each.

A bad file does not stop the others. Its error is printed at once and in a table at the end; the exit code is 1.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from echoavatar.errors import AudioError, EchoAvatarError, one_line
from echoavatar.whole_file import disk_errors, make_output_folder

from .options import FORMATS

STDIN = Path("-")
STDIN_BYTES = 1 << 32  # six hours of stereo in WAV


def add_outputs(parser: argparse.ArgumentParser, several: str) -> None:
    """Declare `-o` and `--format` of a command that takes `several` files."""
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help=f"where to write: {FORMATS}; or a folder for several {several}"
    )
    parser.add_argument(
        "--format",
        type=lambda text: f".{text.removeprefix('.')}",
        default=".glb",
        metavar="SUFFIX",
        help="suffix of the files in a folder (default: %(default)s)",
    )


def outputs(
    inputs: Sequence[Path], output: Path, suffix: str, *, known: Collection[str], kind: str, **others: Path | None
) -> list[Path]:
    """Where each input's output goes: `output` itself, or a file of the input's name in that folder, which is made.

    Args:
        inputs: the files; `STDIN` may be one of them.
        output: as the user gave it.
        suffix: of the files in a folder.
        known: suffixes of files; a folder with another one is taken for a folder.
        kind: what the inputs are, for messages: "sound".
        others: other files that are read, by their kinds.

    Raises:
        EchoAvatarError: inputs and output do not go together, or a file that is read would be written over.
    """
    if output == STDIN:
        raise EchoAvatarError("-o -: files do not go to standard output; name a file, such as NAME.glb")
    if inputs.count(STDIN) > 1:
        raise EchoAvatarError("standard input (-) can be read once; name it once")
    if STDIN in inputs:
        _check_open()
    is_file = bool(output.suffix) and not (output.is_dir() and output.suffix.lower() not in known)
    if is_file and len(inputs) > 1:
        raise EchoAvatarError(f"several {kind}s need a folder: -o {output.with_suffix('')}{os.sep}")
    if is_file:
        made = [output]
    else:
        if output.exists() and not output.is_dir():
            raise EchoAvatarError(f"-o {output} is a file whose suffix is no format's; name another, such as NAME.glb")
        make_output_folder(output)
        stems = ["stdin" if path == STDIN else path.stem for path in inputs]
        if twice := [stem for stem, count in Counter(stems).items() if count > 1]:
            raise EchoAvatarError(f"two {kind}s are called {twice[0]!r} and would go into one file; rename one")
        made = [output / f"{stem}{suffix}" for stem in stems]
    for path, place in zip(inputs, made, strict=True):
        check_apart(place, **{kind: path}, **others)
    return made


def check_apart(output: Path | None, **read: Path | None) -> None:
    """Raise EchoAvatarError if `output` is one of the files that are `read`, given by their kinds."""
    for kind, path in read.items():  # `resolve` fails on circular links
        if output is not None and path is not None and os.path.realpath(output) == os.path.realpath(path):
            raise EchoAvatarError(f"-o {output} is the {kind} itself; choose another name")


@contextmanager
def readable_sound(sound: Path) -> Iterator[Path]:
    """The file itself. Standard input is copied to a file, because readers of most formats seek.

    Raises EchoAvatarError: standard input is closed or too long, or the disk is full.
    """
    if sound != STDIN:
        yield sound
        return
    _check_open()
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "stdin"
        with disk_errors(kept), kept.open("wb") as file:
            while block := sys.stdin.buffer.read(1 << 20):
                file.write(block)
                if file.tell() > STDIN_BYTES:
                    raise EchoAvatarError(
                        f"standard input has more than {STDIN_BYTES:,} bytes; give the sound as a file"
                    )
        try:
            yield kept
        except AudioError as error:
            raise AudioError(str(error).replace(str(kept), "standard input")) from error


def _check_open() -> None:
    if sys.stdin is None:
        raise EchoAvatarError("standard input (-) is closed; send the sound to it, or name a file")


class Batch:
    """The results of several files."""

    def __init__(self, count: int) -> None:
        """`count` files will come; if it is 1, `each` raises its error."""
        self._is_single = count == 1
        self._rows: list[tuple[str, str, str]] = []
        self.made, self._failed = 0, 0

    @contextmanager
    def each(self, name: object, became: object = "made") -> Iterator[None]:
        """A context in which one file is made; an error that the user can mend does not end the batch."""
        try:
            yield
            self.made += 1
            self._rows.append((str(name), str(became), ""))
        except (EchoAvatarError, OSError) as error:
            if self._is_single:
                raise
            self._failed += 1
            self._rows.append((str(name), "failed", one_line(error)))
            print(f"echoavatar: {name}: {one_line(error)}", file=sys.stderr)

    def end(self) -> int:
        """Print the table if any failed; returns the exit code."""
        if not self._failed:
            return 0
        rows = [("file", "result", "cause"), *self._rows]
        widths = [max(len(row[column]) for row in rows) for column in range(2)]
        for row in rows:
            print(f"{row[0]:{widths[0]}}  {row[1]:{widths[1]}}  {row[2]}".rstrip())
        print(f"{self._failed} of {len(self._rows)} failed")
        return 1
