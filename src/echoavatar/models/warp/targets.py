"""Training targets of the warp model: brake curves from known stresses and beats."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.data import Clip
from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME

from ..audio import LevelControl

SLOWEST_AFTER = {"stress": 0.20, "beats": 0.107}
"""Seconds from an event to the slowest moment of the body.

A stroke of the rehearsal corpus ends 0.14 to 0.18 s after the onset of the stressed vowel, and the arm reverses just
after. A dancer brakes on the beat, so the slowest moment follows it.
"""
WIDTH_FRAMES = 2.0  # standard deviation of a dip


class WarpBatch(NamedTuple):
    """Windows of sound and their target curves."""

    audio: Float[Tensor, "b s"]
    brake: Float[Tensor, "b t"]


def brake_curve(events: Mapping[str, Float[np.ndarray, " n"]], frames: int) -> Float[np.ndarray, " t"]:
    """1 where the body should be slowest, falling off on both sides; `events` by kind, in seconds."""
    at, curve = np.arange(frames), np.zeros(frames)
    for kind, after in SLOWEST_AFTER.items():
        for time in events.get(kind, np.zeros(0)):
            dip = np.exp(-0.5 * ((at - (time + after) * FRAME_RATE_HZ) / WIDTH_FRAMES) ** 2)
            curve = np.maximum(curve, dip)
    return curve.astype(np.float32)


class WarpSampler:
    """Random windows of clips, starting at any frame; a function of seed and step."""

    def __init__(self, clips: Sequence[Clip], *, frames: int, seed: int, gain_db: float) -> None:
        """Raises MotionError where no clip is long enough or none has events."""
        chosen = [clip for clip in clips if clip.frames >= frames]
        if not any(clip.events.get(kind, np.zeros(0)).size for clip in chosen for kind in SLOWEST_AFTER):
            raise MotionError(
                f"no clip of at least {frames} frames has stresses or beats; make a corpus with "
                "`echoavatar data rehearse`"
            )
        self._heard = [LevelControl()(torch.from_numpy(clip.audio)[None])[0].numpy() for clip in chosen]
        self._brake = [brake_curve(clip.events, clip.frames) for clip in chosen]
        lengths = np.array([clip.frames for clip in chosen], float)
        self._share, self._frames, self._seed, self._gain_db = lengths / lengths.sum(), frames, seed, gain_db

    def batch(self, step: int, rows: int) -> WarpBatch:
        """The windows of one step."""
        rng = np.random.default_rng([self._seed, step])
        audio, brake = [], []
        for which in rng.choice(len(self._brake), rows, p=self._share):
            first = int(rng.integers(len(self._brake[which]) - self._frames + 1))
            last = first + self._frames
            gain = 10 ** (rng.uniform(-self._gain_db, self._gain_db) / 20)
            audio.append(gain * self._heard[which][first * SAMPLES_PER_FRAME : last * SAMPLES_PER_FRAME])
            brake.append(self._brake[which][first:last])
        return WarpBatch(*(torch.from_numpy(np.stack(part).astype(np.float32)) for part in (audio, brake)))
