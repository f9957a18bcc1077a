"""What a file of motion or of a character is: its content tells, whatever it is called."""

import re
from pathlib import Path

from echoavatar.errors import MotionError
from echoavatar.limits import check_file

BVH, GLTF, NPZ = "BVH", "glTF", "NPZ"
_SUFFIXES = {".bvh": BVH, ".npz": NPZ, **dict.fromkeys((".glb", ".gltf", ".vrm", ".vrma"), GLTF)}
_MARKS = re.compile(rb"\xef\xbb\xbf|\xff\xfe|\xfe\xff|\0")  # of an encoding; every other byte of UTF-16 is 0
_BEGINS = {  # how a file begins, after white space
    rb"glTF|\{": GLTF,
    rb"PK\x03\x04": NPZ,
    rb"(?i)(?:(?:#|//)[^\r\n]*[\r\n]\s*)*HIERARCHY\b": BVH,
    rb"Kaydara FBX|; FBX": "FBX",
    rb"Vocaloid Motion Data": "VMD",
    rb"\x93NUMPY": "a NumPy array without a name",
    rb"\x80[\x02-\x05]": "a pickle, which may run programs",
    rb"version https://git-lfs": "a pointer of Git LFS and not yet fetched",
}
_LARGEST_BYTES = 1 << 40
_HEAD_BYTES = 1 << 16


def kind_of(path: Path) -> str:
    """`BVH`, `GLTF` or `NPZ`; where the content is none of them, what the suffix says, whose reader says what is wrong.

    Raises MotionError: the file is missing or no regular file, or neither content nor suffix is known.
    """
    try:
        check_file(path, _LARGEST_BYTES, MotionError)
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except FileNotFoundError:
        raise MotionError(f"{path} does not exist; check the name") from None
    except OSError as error:
        raise MotionError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
    begin = _MARKS.sub(b"", head).lstrip()
    found = (kind for pattern, kind in _BEGINS.items() if re.match(pattern, begin))
    kind = next(found, _SUFFIXES.get(path.suffix.lower(), "no motion or character that is read"))
    if kind not in (BVH, GLTF, NPZ):
        raise MotionError(f"{path} is {kind}; convert it to .bvh or .glb, for example in Blender")
    return kind
