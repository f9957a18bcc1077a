"""The format of a file of motion or of a character, read from its content, whatever its name."""

import re
import sys
from contextlib import suppress
from pathlib import Path

from echoavatar.errors import MotionError
from echoavatar.limits import check_file, readable

BVH, GLTF, NPZ = "BVH", "glTF", "NPZ"
_SUFFIXES = {".bvh": BVH, ".npz": NPZ, **dict.fromkeys((".glb", ".gltf", ".vrm", ".vrma"), GLTF)}
_MARKS = re.compile(rb"\xef\xbb\xbf|\xff\xfe|\xfe\xff|\0")  # of an encoding; every other byte of UTF-16 is 0
_BEGINS = {  # how a file begins, after white space
    rb"glTF|\{": GLTF,
    rb"PK\x03\x04": NPZ,
    rb"(?i)(?:(?:#|//)[^\r\n]*[\r\n]\s*)*HIERARCHY\b": BVH,
}
_HEAD_BYTES = 1 << 16


def kind_of(path: Path) -> str:
    """`BVH`, `GLTF` or `NPZ` by the content, or else by the suffix; "" where neither is known.

    A missing or damaged file with a known suffix is left to the reader of that kind, which reports the fault. Raises
    MotionError: there is no such file, and its suffix is unknown.
    """
    head = b""
    with suppress(OSError, ValueError):
        if path.is_file():
            with path.open("rb") as file:
                head = file.read(_HEAD_BYTES)
    begin = _MARKS.sub(b"", head).lstrip()
    by_content = (kind for pattern, kind in _BEGINS.items() if re.match(pattern, begin))
    kind = next(by_content, _SUFFIXES.get(path.suffix.lower(), ""))
    if not (kind or head):
        with readable(path, MotionError):
            check_file(path, sys.maxsize, MotionError)
    return kind
