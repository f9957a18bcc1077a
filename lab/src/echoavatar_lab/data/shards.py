"""Shards: many clips end to end in a few flat `.npy` files that are memory-mapped.

A shard has up to four files: `rotations` (n, j, 4) float32, `root` (n, 3) float32, `domain` (n,) uint8 and, for clips
with sound, `audio` (800 n,) int16 at 24 kHz. Frames `start` to `start + frames` belong to one clip. The manifest holds
the checksum of every file; a shard is complete once the manifest lists it.
"""

import hashlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.timing import SAMPLES_PER_FRAME

TYPES = {"rotations": np.float32, "root": np.float32, "domain": np.uint8, "audio": np.int16}


class ShardEntry(Config):
    """One shard as the manifest lists it."""

    name: str = Field(description="prefix of its file names")
    frames: int = Field(gt=0, description="length at 30 frames per second, all clips together")
    skeleton: int = Field(default=0, ge=0, description="index of its rig in the manifest's skeletons")
    sha256: dict[str, str] = Field(description="checksum of each array's file")


class Shard:
    """The arrays of a shard, mapped on first access.

    Access raises MotionError if the file is missing, damaged or of another shape.
    """

    def __init__(self, folder: Path, entry: ShardEntry) -> None:
        self.folder, self.entry = folder, entry

    @property
    def has_sound(self) -> bool:
        """Whether its clips have sound."""
        return "audio" in self.entry.sha256

    @cached_property
    def rotations(self) -> NDArray[np.float32]:
        """(n, j, 4) quaternions `wxyz`."""
        return self._mapped("rotations")

    @cached_property
    def root(self) -> NDArray[np.float32]:
        """(n, 3) metres."""
        return self._mapped("root")

    @cached_property
    def domain(self) -> NDArray[np.uint8]:
        """(n,) index into `DOMAINS`."""
        return self._mapped("domain")

    @cached_property
    def audio(self) -> NDArray[np.int16]:
        """(800 n,) 16-bit samples at 24 kHz."""
        return self._mapped("audio")

    def path(self, array: str) -> Path:
        """Path of one array's file."""
        return shard_path(self.folder, self.entry.name, array)

    def verify(self) -> None:
        """Raise MotionError for the first file that is missing or has changed."""
        for array, wanted in self.entry.sha256.items():
            path = self.path(array)
            if not path.is_file():
                raise MotionError(f"shard {path} is missing; prepare the set again")
            if checksum(path) != wanted:
                raise MotionError(f"shard {path} changed; prepare the set again")

    def _mapped(self, array: str) -> NDArray[Any]:
        path = self.path(array)
        try:
            values: NDArray[Any] = np.load(
                path, mmap_mode="c", allow_pickle=False
            )  # copy on write: torch needs writable memory
        except FileNotFoundError as error:
            raise MotionError(f"shard {path} is missing; prepare the set again") from error
        except (OSError, ValueError, EOFError) as error:
            raise MotionError(f"shard {path} is damaged ({error}); prepare the set again") from error
        wanted = self.entry.frames * (SAMPLES_PER_FRAME if array == "audio" else 1)
        if values.dtype != TYPES[array] or len(values) != wanted:
            raise MotionError(
                f"shard {path} holds {len(values)} rows of {values.dtype}, the manifest says {wanted} of"
                f" {np.dtype(TYPES[array])}; prepare the set again"
            )
        return values


def write_shard(folder: Path, name: str, arrays: Mapping[str, NDArray[Any]], *, skeleton: int = 0) -> ShardEntry:
    """Write the arrays of a shard, each file completely or not at all.

    Raises:
        MotionError: a file cannot be written.
    """
    sums = {}
    for array, values in arrays.items():
        path = shard_path(folder, name, array)
        partial = path.with_name(path.name + ".part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with partial.open("wb") as file:
                np.save(file, np.ascontiguousarray(values, TYPES[array]))
            sums[array] = checksum(partial)
            partial.replace(path)
        except OSError as error:
            raise MotionError(
                f"{path} cannot be written ({error.strerror}); free space or choose another folder, then run again"
            ) from error
        finally:
            if partial.is_file():
                partial.unlink()
    return ShardEntry(name=name, frames=len(arrays["root"]), skeleton=skeleton, sha256=sums)


def shard_path(folder: Path, name: str, array: str) -> Path:
    """Path of one array of a shard in a set."""
    return folder / "shards" / f"{name}.{array}.npy"


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
