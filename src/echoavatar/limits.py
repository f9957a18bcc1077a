"""Limits on files from outside, and the check that every reader makes before it opens one.

A file may be damaged or made to do harm. What a reader allocates is bounded by these constants, never by a number that
the file itself states. Uses only `errors`.
"""

import stat
from pathlib import Path

from .errors import EchoAvatarError

CONFIG_BYTES = 16 << 20  # one JSON file: a config, a card, a table
JSON_VALUES = 1 << 20  # numbers, texts, lists and objects of one JSON text; a VRM avatar has some 100,000
BVH_BYTES = 1 << 29
GLB_BYTES = 1 << 29
ARRAYS_BYTES = 1 << 30  # all arrays of one .npz, unpacked: an hour of motion and sound takes half

JOINTS = 4096  # of one skeleton
DEPTH = 512  # joints from the root to a fingertip; also keeps recursive writers within Python's stack
ROTATIONS = 1 << 25  # frames x joints of one clip: two hours of a body with its hands at 60 fps

NODES = 1 << 16  # of one glTF file
VERTICES = 1 << 21  # of all its skinned meshes
MORPHS = 1 << 13  # morph targets of all its nodes
WEIGHTS = 1 << 28  # vertices x joints

PICKLED_BYTES = 64 << 20  # one pickled table: statistics have some hundred numbers
PICKLED_STEPS = 100_000  # instructions of one pickle; a table of arrays takes some hundred


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
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{path} is not a regular file; give the name of a file")
    if found.st_size > largest:
        raise error(f"{path} has {found.st_size:,} bytes, and at most {largest:,} are read; give a smaller file")
