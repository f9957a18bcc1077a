"""Sound in, 52 curves out, 8 frames per step, many sessions in one batch.

Paper, Face Animation Generator, Inference: 8 frames per step from 63 frames of sound and 56 of motion, 3-step flow
matching, guidance 2.0. A session's face depends on its own sound and seed only.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.motion.arkit import APPLE_NAMES, ARKIT_NAMES
from echoavatar.nn import StreamState
from echoavatar.nn.exported import ExportedStep
from echoavatar.timing import SAMPLES_PER_FRAME

from .decoder import FrameDecoder
from .flow import face_noise
from .gpt import GptState
from .idle import IdleFace, IdleState, frame_loudness
from .model import FaceModel


@dataclass
class FaceState(StreamState):
    """All zero: the mean face, nothing heard yet."""

    encoder: StreamState
    gpt: GptState
    idle: IdleState


class FaceStream:
    """A running face model, with idle motion (`idle`) on the channels that it does not move."""

    def __init__(self, model: FaceModel, *, has_idle: bool = True, ear: ExportedStep | None = None) -> None:
        """Without `has_idle` the curves are the model's alone; `ear` is the exported `FaceModel.hear` (ring form)."""
        self.model, self._ear = model.eval(), ear
        names = APPLE_NAMES if model.config.order == "apple" else ARKIT_NAMES
        self._order = torch.tensor([names.index(name) for name in ARKIT_NAMES])
        moving = model.moving().cpu()[self._order]
        self.idle = IdleFace(moving if model.config.idle and has_idle else torch.ones_like(moving))
        self._decoder = FrameDecoder(model) if model.config.memory == "ring" else None
        with torch.no_grad():
            self._schedule = model.head.schedule(model.config.sampling_steps)

    def init_state(self, rows: int) -> FaceState:
        """A fresh state."""
        model = self.model
        ear = self._ear or model.encoder
        states = ear.init_state(rows).mapped(torch.as_tensor), model.gpt.init_state(rows), self.idle.init_state(rows)
        return FaceState(*states)

    @torch.no_grad()
    def step(
        self, audio: Float[Tensor, "b s"], state: FaceState, active: Bool[Tensor, " b"], seeds: Int[Tensor, " b"]
    ) -> Float[Tensor, "b t 52"]:
        """Curves (0 to 1) of the next steps, 6,400 samples or the config's; the curves of inactive rows mean nothing.

        Raises ValueError if the samples are not whole steps.
        """
        samples = self.model.config.step * SAMPLES_PER_FRAME
        if audio.shape[1] % samples or not audio.shape[1]:
            raise ValueError(f"a step takes a multiple of {samples} samples, got {audio.shape[1]}")

        with _one_thread():
            faces = self._faces(audio, state, active, seeds)
            return self.idle.step(faces, frame_loudness(audio), state.idle, active, seeds)

    def _faces(self, audio: Tensor, state: FaceState, active: Tensor, seeds: Tensor) -> Float[Tensor, "b t 52"]:
        """The model's curves, without idle motion."""
        gpt, faces = self.model.gpt, []
        for chunk in torch.split(audio, self.model.config.step * SAMPLES_PER_FRAME, dim=1):
            noise = self._noise(state.gpt.seen, seeds)
            if self._decoder is None:
                features = self.model.encoder.step(chunk, state.encoder, active)
                normal = self.generate(features, state.gpt, active, noise)
            else:
                heard = self._hear(chunk, state.encoder, active)
                frames = self._decoder.run(state.gpt, heard, active, noise, self._schedule)
                normal = torch.from_numpy(frames).to(noise)
                gpt.commit(state.gpt, normal, heard, active)
            faces.append(self.model.denormalize(normal).clamp(0, 1)[..., self._order])
        return torch.cat(faces, 1)

    def _hear(self, chunk: Tensor, state: StreamState, active: Tensor) -> Tensor:
        if self._ear is None:
            return self.model.hear(chunk, state, active)
        past = state.mapped(lambda part: part.numpy())
        return torch.from_numpy(self._ear.step(chunk.numpy(), past, active.numpy()))

    @torch.no_grad()
    def generate(
        self,
        features: Float[Tensor, "b n a"],
        state: GptState,
        active: Bool[Tensor, " b"],
        noise: Float[Tensor, "b t c"],
    ) -> Float[Tensor, "b t c"]:
        """Normalised frames of one step (window form), from the features of its frames and, in front, earlier ones."""
        gpt, config = self.model.gpt, self.model.config
        features = torch.cat([state.sound, features], 1)[:, -(state.sound.shape[1] + config.step) :]
        sound = gpt.sound_proj(features)
        run, last, frames = gpt.begin(state, sound), state.motion[:, -1], []
        for i in range(config.step):
            condition = gpt.next(run, last, sound[:, i - config.step])
            last = self.model.head.sample(condition, noise[:, i], self._schedule, guidance=config.guidance)
            frames.append(last)
        generated = torch.stack(frames, 1)
        gpt.commit(state, generated, features, active)
        return generated

    def _noise(self, frame: Int[Tensor, " b"], seeds: Int[Tensor, " b"]) -> Float[Tensor, "b n c"]:
        config = self.model.config
        noise = face_noise(seeds, frame, count=config.step, channels=config.channels, hold=config.noise_hold)
        return noise.to(self.model.mean)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Operations as small as these take longer when torch shares them out, above all on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
