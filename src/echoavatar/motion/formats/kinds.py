"""What a file of motion or of a character is: its content tells, whatever it is called."""

import re
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
    """`BVH`, `GLTF` or `NPZ`; where the content is none of them, what the suffix says, whose reader says what is wrong.

    Raises MotionError: the file is missing or no regular file, or neither content nor suffix is known.
    """
    with readable(path, MotionError):
        check_file(path, 1 << 40, MotionError)
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    begin = _MARKS.sub(b"", head).lstrip()
    by_content = (kind for pattern, kind in _BEGINS.items() if re.match(pattern, begin))
    kind = next(by_content, _SUFFIXES.get(path.suffix.lower()))
    if kind is None:
        raise MotionError(f"{path} is neither BVH nor glTF nor NPZ; convert it, for example to .glb in Blender")
    return kind
