"""Windows of clips for a training step: behind the level control, at three speeds, chosen by seed and step alone."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.models.audio import LevelControl
from echoavatar.timing import SAMPLES_PER_FRAME

from .clip import FaceClip
from .tempo import SPEEDS, at_speed


class FaceBatch(NamedTuple):
    """Windows: sound, curves, and the frame before each window."""

    audio: Float[Tensor, "b s"]
    curves: Float[Tensor, "b t c"]
    before: Float[Tensor, "b c"]


class FaceSampler:
    """Windows of clips at the given speeds, starting at any frame; the same for the same seed and step."""

    def __init__(
        self,
        clips: Sequence[FaceClip],
        *,
        frames: int,
        seed: int,
        gain_db: float = 0.0,
        speeds: Sequence[float] = SPEEDS,
        late: int = 0,
    ) -> None:
        """`late`: frames by which the face of a window follows its sound."""
        long_enough = [clip for clip in clips if round(len(clip.curves) / max(speeds)) > frames]
        if not long_enough:
            raise MotionError(f"no face clip of split train is longer than {frames} frames; record longer takes")
        self._versions = [[following(at_speed(clip, speed), late) for speed in speeds] for clip in long_enough]
        lengths = np.array([len(clip.curves) for clip in long_enough], float)
        self._share, self._frames, self._seed, self._gain_db = lengths / lengths.sum(), frames, seed, gain_db

    def batch(self, step: int, rows: int) -> FaceBatch:
        """The windows of one step."""
        rng = np.random.default_rng([self._seed, step])
        audio, curves, before = [], [], []
        for which in rng.choice(len(self._versions), rows, p=self._share):
            clip = self._versions[which][rng.integers(len(self._versions[which]))]
            first = int(rng.integers(len(clip.curves) - self._frames + 1))
            last = first + self._frames
            gain = 10 ** (rng.uniform(-self._gain_db, self._gain_db) / 20)
            audio.append(gain * clip.audio[first * SAMPLES_PER_FRAME : last * SAMPLES_PER_FRAME])
            curves.append(clip.curves[first:last])
            before.append(clip.curves[max(first - 1, 0)])
        return FaceBatch(*(torch.from_numpy(np.stack(part).astype(np.float32)) for part in (audio, curves, before)))


def following(clip: FaceClip, frames: int) -> FaceClip:
    """The clip with its face delayed by some frames; the first face is held meanwhile."""
    held = np.repeat(clip.curves[:1], frames, axis=0)
    return replace(clip, curves=np.concatenate([held, clip.curves[: len(clip.curves) - frames]]))


def levelled(clip: FaceClip) -> FaceClip:
    """The clip as the live model hears it, behind the level control."""
    audio = LevelControl()(torch.from_numpy(clip.audio)[None])[0].numpy()
    return replace(clip, audio=audio)
