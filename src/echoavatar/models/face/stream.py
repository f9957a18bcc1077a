"""Sound in, 52 curves out, a step of `FaceConfig.step` frames at a time, many sessions in one batch.

Paper, Face Animation Generator, Inference: 8 frames per step from 63 frames of sound and 56 of motion, 3-step flow
matching, guidance 2.0. A session's face depends on its own sound and seed only.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES
from echoavatar.nn import StreamState
from echoavatar.timing import SAMPLES_PER_FRAME

from .config import STILL, FaceConfig
from .decoder import FrameDecoder
from .idle import IdleFace, IdleState, frame_loudness
from .noise import face_noise


@dataclass
class FaceState(StreamState):
    """All zero: the mean face, nothing heard yet."""

    encoder: StreamState
    frames: Any  # state of the ring or of the window
    idle: IdleState


class FaceStream:
    """A running face, with idle motion (`idle`) on the channels that the model does not move."""

    def __init__(
        self,
        config: FaceConfig,
        weights: Mapping[str, Float[np.ndarray, "..."]],
        ear: Any,
        frames: Any = None,
        *,
        has_idle: bool = True,
    ) -> None:
        """`weights` are those of a checkpoint by name. Without `has_idle` the curves are the model's alone.

        `ear` is the step from sound to audio features, `frames` that from these to curves (None: `FrameDecoder`).
        """
        self.config, self._ear, self._frames = config, ear, frames or FrameDecoder(config, weights)
        names = APPLE_NAMES if config.order == "apple" else ARKIT_NAMES
        self._order = [names.index(name) for name in ARKIT_NAMES]
        self._mean, std = weights["mean"][self._order], weights["std"][self._order]
        moving = std > STILL
        self._spread = np.maximum(std, config.least_scale) * moving
        self.idle = IdleFace(moving if config.idle and has_idle else np.ones(len(names), np.bool_))

    def init_state(self, rows: int) -> FaceState:
        """A fresh state."""
        return FaceState(self._ear.init_state(rows), self._frames.init_state(rows), self.idle.init_state(rows))

    def step(
        self, audio: Float[Any, "b s"], state: FaceState, active: Bool[Any, " b"], seeds: Int[Any, " b"]
    ) -> Float[Any, "b t 52"]:
        """Curves (0 to 1) of the next steps, 800 samples a frame; the curves of inactive rows mean nothing.

        Raises ValueError if the samples are not whole steps.
        """
        config = self.config
        samples = config.step * SAMPLES_PER_FRAME
        if audio.shape[1] % samples or not audio.shape[1]:
            raise ValueError(f"a step takes a multiple of {samples} samples, got {audio.shape[1]}")
        count, made = audio.shape[1] // samples, []
        noise = face_noise(
            seeds, state.idle.seen, count=count * config.step, channels=config.channels, hold=config.noise_hold
        )
        for at in range(count):
            heard = self._ear.step(audio[:, at * samples : (at + 1) * samples], state.encoder, active)
            drawn = noise[:, at * config.step : (at + 1) * config.step]
            made.append(self._frames.step(heard, state.frames, active, drawn))
        faces = np.clip(np.concatenate(made, 1)[..., self._order] * self._spread + self._mean, 0, 1)
        return self.idle.step(faces, frame_loudness(audio), state.idle, active, seeds)
