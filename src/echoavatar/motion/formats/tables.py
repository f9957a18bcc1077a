"""Motion and faces as plain tables: CSV for spreadsheets and other programs, NPZ for NumPy."""

import io
import math
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import ValidationError

from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object
from echoavatar.limits import ARRAYS_ALWAYS, ARRAYS_BYTES, ARRAYS_PACKED, TEXTS, check_file, readable
from echoavatar.whole_file import write_whole

from ..arkit import LIVE_LINK_NAMES, to_live_link
from ..kinematics.motion import Motion
from ..kinematics.skeleton import Skeleton, SkeletonConfig

_MEANS_MORE = re.compile('^[=+@-]|[,;"]')  # in a table: the start of a formula, the end of a cell


def write_csv(path: Path | str, motion: Motion) -> None:
    """Write one row per frame: seconds, root in metres, then w x y z of each joint's parent-relative quaternion."""
    head = ["time", "root.x", "root.y", "root.z"]
    names = [_MEANS_MORE.sub("_", name) for name in motion.skeleton.names]
    head += [f"{name}.{axis}" for name in names for axis in "wxyz"]
    times = np.arange(motion.frames)[:, None] / motion.fps
    table = np.concatenate([times, motion.root, motion.rotations.reshape(motion.frames, -1)], 1)
    row = ",".join(["%.6f"] * table.shape[1])
    text = "\n".join([",".join(head), *(row % tuple(frame) for frame in table.tolist())])
    write_whole(path, text + "\n", error=MotionError)


def write_live_link(path: Path, curves: Float[np.ndarray, "t 52"], fps: float = 30.0) -> None:
    """Write curves as a Live Link Face CSV (61 columns, timecode from 00:00:00 at 30 or 60 frames per second).

    Raises MotionError: the file cannot be written.
    """
    base = 60 if fps > 30 else 30
    head = ["Timecode", "BlendshapeCount", *(name[:1].upper() + name[1:] for name in LIVE_LINK_NAMES)]
    rows = [",".join(head)]
    for frame, values in enumerate(to_live_link(curves)):
        stamp = _timecode(frame / fps, base)
        rows.append(",".join([stamp, str(len(values)), *(f"{value:.6f}" for value in values)]))
    write_whole(path, "\n".join(rows) + "\n", error=MotionError)


def _timecode(seconds: float, base: int) -> str:
    """hh:mm:ss:ff.fff, ff counting 1/base s."""
    thousandths = round(seconds * base * 1000)
    whole, part = divmod(thousandths, base * 1000)
    minutes, second = divmod(whole, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}:{minute:02d}:{second:02d}:{part // 1000:02d}.{part % 1000:03d}"


def write_npz(path: Path | str, motion: Motion, **beside: np.ndarray) -> None:
    """Write arrays `rotations` (t, j, 4) `wxyz`, `root` (t, 3), `fps`, and `skeleton` as JSON text; no pickles.

    `beside` are further arrays to store, such as a face.
    """
    arrays: dict[str, Any] = {
        "rotations": motion.rotations,
        "root": motion.root,
        "fps": np.array(motion.fps),
        "skeleton": np.array(motion.skeleton.config.model_dump_json()),
    }
    write_arrays(path, arrays | beside)


def write_arrays(path: Path | str, arrays: Mapping[str, Any]) -> None:
    """Write arrays as NPZ without pickles, completely or not at all."""
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **arrays)
    write_whole(path, packed.getvalue(), error=MotionError)


def read_npz(path: Path | str) -> Motion:
    """Read a file of `write_npz`; raises MotionError where it is missing, damaged, or something else."""
    try:
        with readable(path, MotionError):
            return motion_of(arrays_of(Path(path), MotionError))
    except NPZ_ERRORS as error:
        raise MotionError(f"{path} holds no motion or is damaged ({str(error)[:160]}); write it again") from error


def motion_of(stored: Mapping[str, np.ndarray]) -> Motion:
    """The motion in arrays that `write_npz` wrote; raises one of `NPZ_ERRORS` where they are something else."""
    try:
        rig = read_object(str(stored["skeleton"]), "the skeleton")
    except EchoAvatarError as error:
        raise ValueError(str(error)) from error
    skeleton = Skeleton(SkeletonConfig.model_validate(rig))
    return Motion(skeleton, stored["rotations"], stored["root"], float(stored["fps"]))


NPZ_ERRORS = (OSError, ValueError, KeyError, EOFError, IndexError, TypeError, zipfile.BadZipFile, ValidationError)


class NpzArrays(zipfile.ZipFile, Mapping[str, np.ndarray]):
    """The arrays of an npz file, each read when it is asked for. Sizes are checked before anything is unpacked.

    Opening and reading raise FileNotFoundError, OSError, ValueError or zipfile.BadZipFile for files that are missing,
    damaged, or with pickles in them.
    """

    def __init__(self, path: Path, error: type[EchoAvatarError] = EchoAvatarError, *, most: int | None = None) -> None:
        """Raises an error of the given kind: the file, or what it unpacks to, has more bytes than `most`.

        `most` is `limits.ARRAYS_BYTES` by default, and less for a file that is packed very tightly (`ARRAYS_PACKED`).
        """
        most = ARRAYS_BYTES if most is None else most
        check_file(path, most, error)
        try:
            super().__init__(path)
        except (zipfile.LargeZipFile, NotImplementedError, RuntimeError) as reason:
            raise ValueError(str(reason)) from reason
        entries = self.infolist()
        unpacked = sum(entry.file_size for entry in entries)
        most = min(most, max(ARRAYS_ALWAYS, ARRAYS_PACKED * path.stat().st_size))
        if unpacked > most:
            self.close()
            raise error(f"{path} unpacks to {unpacked:,} bytes, and at most {most:,} are read; cut it")
        self._names = {entry.filename.removesuffix(".npy"): entry.filename for entry in entries}

    def __getitem__(self, key: str) -> np.ndarray:
        name = self._names[key]
        try:
            return array_of(self.read(name))
        except (NotImplementedError, RuntimeError) as reason:  # an unknown method, or encrypted
            raise ValueError(str(reason)) from reason
        except zlib.error as reason:
            raise ValueError(f"damaged: {reason}") from reason

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def arrays_of(path: Path, error: type[EchoAvatarError] = EchoAvatarError) -> dict[str, np.ndarray]:
    """Every array of an npz file; raises what `NpzArrays` raises."""
    with NpzArrays(path, error) as stored:
        return dict(stored)


def array_of(data: bytes) -> np.ndarray:
    """The array of an npy file's bytes; raises ValueError where header and data do not fit, and for pickles."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise ValueError("it holds objects of Python; save plain arrays")
    if math.prod(shape) * dtype.itemsize > len(data) - file.tell():
        raise ValueError(f"the header says {shape}, and there is less")
    if dtype.kind in "SU" and math.prod(shape) > TEXTS:  # each becomes an object of Python
        raise ValueError(f"{math.prod(shape):,} texts, and at most {TEXTS:,} are read")
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
