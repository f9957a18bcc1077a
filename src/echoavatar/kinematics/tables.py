"""Motion as plain tables: CSV for spreadsheets and other programs, NPZ for numpy."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from echoavatar.errors import MotionError

from .motion import Motion
from .skeleton import Skeleton, SkeletonConfig


def write_csv(path: Path | str, motion: Motion) -> None:
    """One row a frame: time in seconds, root in metres, then w x y z of each joint's parent-relative quaternion."""
    head = ["time", "root.x", "root.y", "root.z"]
    head += [f"{name}.{axis}" for name in motion.skeleton.names for axis in "wxyz"]
    times = np.arange(motion.frames)[:, None] / motion.fps
    table = np.concatenate([times, motion.root, motion.rotations.reshape(motion.frames, -1)], 1)
    row = ",".join(["%.6f"] * table.shape[1])
    text = "\n".join([",".join(head), *(row % tuple(frame) for frame in table.tolist())])
    _write(path, (text + "\n").encode())


def write_npz(path: Path | str, motion: Motion, **beside: np.ndarray) -> None:
    """Arrays `rotations` (t, j, 4) `wxyz`, `root` (t, 3), `fps`, and `skeleton` as JSON text; no pickles.

    `beside` are further arrays to store, such as a face.
    """
    path = Path(path)
    partial = path.with_name(path.name + ".part")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, **(_arrays(motion) | beside))
        partial.replace(path)
    except OSError as error:
        raise MotionError(f"{path} cannot be written ({error.strerror}); choose another place") from error
    finally:
        partial.unlink(missing_ok=True)


def read_npz(path: Path | str) -> Motion:
    """Read what `write_npz` wrote; raises MotionError for a missing, damaged or foreign file."""
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as stored:
            skeleton = Skeleton(SkeletonConfig.model_validate_json(str(stored["skeleton"])))
            return Motion(skeleton, stored["rotations"], stored["root"], float(stored["fps"]))
    except FileNotFoundError as error:
        raise MotionError(f"{path} does not exist; check the name") from error
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, ValidationError) as error:
        raise MotionError(f"{path} holds no motion of ours or is damaged; write it again") from error


def _arrays(motion: Motion) -> dict[str, Any]:
    return {
        "rotations": motion.rotations,
        "root": motion.root,
        "fps": np.array(motion.fps),
        "skeleton": np.array(motion.skeleton.config.model_dump_json()),
    }


def _write(path: Path | str, data: bytes) -> None:
    path = Path(path)
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_bytes(data)
        partial.replace(path)
    except OSError as error:
        raise MotionError(f"{path} cannot be written ({error.strerror}); choose another place") from error
    finally:
        partial.unlink(missing_ok=True)
