"""Limits on files from outside, and the check that every reader makes before it opens one.

A file may be damaged or made to do harm. A reader's memory is bounded by these constants, never by a number that
the file itself states. Uses only `errors`.
"""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import EchoAvatarError

CONFIG_BYTES = 16 << 20  # one JSON file: a config, a card, a table
JSON_VALUES = 1 << 20  # numbers, strings, lists and objects of one JSON text; a VRM avatar has some 100,000
GLTF_BYTES = 16 << 20  # the JSON in a GLB; VRM avatars have 1 to 6 MiB
BVH_BYTES = 1 << 29
BVH_LINES = 1 << 21  # two hours at 240 frames a second
BVH_LINE = 1 << 18  # characters of a line; a frame of `JOINTS` joints has fewer
GLB_BYTES = 1 << 28  # avatars with large pictures have some 100 MiB
ARRAYS_BYTES = 1 << 30  # all arrays of one .npz, unpacked: an hour of motion and sound takes half
ARRAYS_PACKED = 16  # a .npz unpacks to at most so many times its size, or to ARRAYS_ALWAYS
ARRAYS_ALWAYS = 1 << 27  # bytes

JOINTS = 1024  # of one skeleton; avatars with long hair and skirts have some 500
DEPTH = 512  # joints from the root to a fingertip; also keeps recursive writers within Python's stack
ROTATIONS = 1 << 25  # frames x joints of one clip: two hours of a body with its hands at 60 fps
STILL_ROTATIONS = 1 << 20  # frames x joints beyond the values in the file: joints without channels cost it nothing

# Limits of one glTF file. A mesh or a skin counts once for each node that uses it.
NODES = 1 << 14  # avatars have some 1,000
SKIN_JOINTS = 1 << 16  # entries of all skins; avatars have up to 100 skins that list the same joints
PRIMITIVES = 1 << 13  # of all skinned nodes; one for each material
VERTICES = 1 << 20  # of all skinned nodes; avatars have some 100,000
MORPHS = 1 << 13  # morph targets of all nodes; a face has 50 to 200
CORNERS = 3 << 21  # of the triangles that a film draws; avatars have some 300,000
MORPHED = 1 << 25  # vertices of all morph targets that a film moves; a face has some 2,000,000
FILE_PARTS = 1 << 11  # buffers and pictures; a scanned scene has some 100
UNPACKED_BYTES = 1 << 26  # of all compressed data that is unpacked; a million vertices with weights take half
BINDS = 1 << 14  # morph targets that all expressions name; perfect sync has some 100 expressions
PIXELS = 1 << 24  # of one picture, 4096 x 4096

ACTIONS = 256  # of one bundle; each one is offered to language models
OVERLAYS = 1 << 20  # frames x joints of the hands of all actions; the shipped ones have 31,000

PICKLED_BYTES = 64 << 20  # one pickled table: statistics have some hundred numbers
PICKLED_STEPS = 100_000  # instructions of one pickle; a table of arrays takes some hundred
TEXTS = 1 << 16  # texts in one array of a .npz: names of joints and curves


def check_file(path: Path, largest: int, error: type[EchoAvatarError] = EchoAvatarError) -> None:
    """Refuse a path that is no regular file (opening a FIFO would hang), or a file of more than `largest` bytes.

    Raises:
        FileNotFoundError: there is nothing; the caller knows the remedy.
        EchoAvatarError: of the given kind.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as reason:
        raise error(f"{path} cannot be read ({reason}); check the name and its permissions") from reason
    _check(path, found, largest, error)


@contextmanager
def readable(path: Path | str, error: type[EchoAvatarError] = EchoAvatarError) -> Iterator[None]:
    """A context in which a file that is missing, or that the system does not open, is an error of the given kind."""
    try:
        yield
    except FileNotFoundError as reason:
        raise error(f"{path} does not exist; check the name") from reason
    except OSError as reason:
        raise error(f"{path} cannot be read ({reason.strerror or reason}); check its permissions") from reason


def read_bytes(path: Path, largest: int, error: type[EchoAvatarError] = EchoAvatarError) -> bytes:
    """The bytes of a file that passes `check_file`; the opened file is checked again, as it may have been replaced.

    Raises:
        OSError: as `check_file`, or it cannot be opened.
        EchoAvatarError: as `check_file`.
    """
    check_file(path, largest, error)
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0))) as file:
        found = os.fstat(file.fileno())
        _check(path, found, largest, error)
        return file.read(found.st_size)


def _check(path: Path, found: os.stat_result, largest: int, error: type[EchoAvatarError]) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{path} is not a regular file; give the name of a file")
    if found.st_size > largest:
        raise error(f"{path} has {found.st_size:,} bytes, and at most {largest:,} are read; give a smaller file")


def decoded(data: bytes) -> tuple[str, str]:
    """The text of a file that begins with ASCII, and the encoding that its bytes suggest.

    Shift-JIS is tried before GBK where bytes 0x81 to 0x9f occur, because it alone has many of them.
    """
    wide = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}.get(data[:2])
    if wide or 0 in data[:2]:
        return data.decode(wide or ("utf-16-be" if data[:1] == b"\0" else "utf-16-le"), "replace"), "utf-16"
    older = ("shift_jis", "gbk") if re.search(rb"[\x81-\x9f]", data) else ("gb2312",)
    for guess in ("utf-8-sig", *older):
        with suppress(UnicodeDecodeError):
            return data.decode(guess), guess
    return data.decode("cp1252", "replace"), "cp1252"


def read_text(
    path: Path, remedy: str, *, largest: int = CONFIG_BYTES, error: type[EchoAvatarError] = EchoAvatarError
) -> str:
    """The UTF-8 text of a file; a byte order mark is passed over. `remedy` ends the message where it cannot be read.

    Raises EchoAvatarError: of the given kind; there is no such regular file, it is too large, or not UTF-8.
    """
    try:
        return read_bytes(path, largest, error).decode("utf-8-sig").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"{path} cannot be read ({getattr(reason, 'strerror', None) or reason}); {remedy}") from reason
