"""A face clip: sound and the curves that go with it, 24 kHz and 30 frames per second, one `.npz` without pickles.

The names of the curves are stored with them, so a file from elsewhere may hold fewer, or another order.
"""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import ARKIT_NAMES, reorder
from echoavatar.motion.formats.tables import NpzArrays
from echoavatar.timing import SAMPLES_PER_FRAME
from echoavatar.whole_file import whole_file

_PCM = 32767.0
SPLITS = ("train", "test")


@dataclass(frozen=True)
class FaceClip:
    """Sound and curves of equal length.

    Attributes:
        name: file-safe name.
        audio: (800 t,) float32 mono at 24 kHz.
        curves: (t, 52) float32 in canonical order.
        split: "train" or "test".
    """

    name: str
    audio: Float[np.ndarray, " s"]
    curves: Float[np.ndarray, "t c"]
    split: str = "train"

    def __post_init__(self) -> None:
        """Raises MotionError for shapes that do not fit and values that are not finite."""
        frames = len(self.curves)
        if self.curves.shape != (frames, len(ARKIT_NAMES)) or not frames:
            raise MotionError(f"face clip {self.name}: curves have shape {self.curves.shape}, wanted (frames, 52)")
        if self.audio.shape != (frames * SAMPLES_PER_FRAME,):
            raise MotionError(
                f"face clip {self.name}: {self.audio.shape} samples for {frames} frames; wanted "
                f"{frames * SAMPLES_PER_FRAME} (800 per frame)"
            )
        if not (np.isfinite(self.curves).all() and np.isfinite(self.audio).all()):
            raise MotionError(f"face clip {self.name}: some values are not numbers; repair or drop those frames")
        if self.split not in SPLITS:
            raise MotionError(f"face clip {self.name}: split is {self.split!r}, use one of {', '.join(SPLITS)}")

    def save(self, path: Path) -> None:
        """Write the clip, whole or not at all; sound as 16-bit PCM, curves as float16."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path, error=MotionError) as partial, partial.open("wb") as file:
            np.savez_compressed(
                file,
                name=np.array(self.name),
                audio=np.round(np.clip(self.audio, -1, 1) * _PCM).astype(np.int16),
                curves=self.curves.astype(np.float16),
                channels=np.array(ARKIT_NAMES),
                split=np.array(self.split),
            )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a clip.

        Raises:
            MotionError: the file is missing, damaged or not a face clip.
        """
        try:
            with NpzArrays(path, MotionError) as file:
                audio = file["audio"].astype(np.float32) / _PCM
                curves = reorder(file["curves"].astype(np.float32), [str(name) for name in file["channels"]])
                return cls(str(file["name"]), audio.astype(np.float32), curves, str(file["split"]))
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
            raise MotionError(f"{path} is not a readable face clip ({error}); make it again") from error


def load_clips(folder: Path) -> list[FaceClip]:
    """All clips of a folder, by name.

    Raises:
        MotionError: there are none, or one is damaged.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise MotionError(f"{folder} holds no face clips (*.npz); make some with 'echoavatar data face'")
    return [FaceClip.load(path) for path in paths]
