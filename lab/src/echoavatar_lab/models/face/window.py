"""The window form frame by frame: the history of a step is read once, then keys and values grow with its frames."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.nn import StreamState
from echoavatar_lab.nn.stream import write_rows

from .gpt import WindowBlock

if TYPE_CHECKING:
    from .model import FaceModel

BRANCHES = 2  # without sound, with sound: both guidance branches of a session ride in one batch


@dataclass
class WindowState(StreamState):
    """All zero: the mean face, no sound. Both end with the last frame."""

    motion: Float[Tensor, "b m c"]  # normalised
    sound: Float[Tensor, "b p a"]  # features of the past inputs


class WindowFrames:
    """Runs backbone and head of a model."""

    def __init__(self, model: "FaceModel") -> None:
        self._model, self._config = model, model.config
        self._blocks = [block for block in model.gpt.blocks if isinstance(block, WindowBlock)]
        with torch.no_grad():
            self._schedule = model.head.schedule(model.config.sampling_steps)

    def init_state(self, rows: int) -> WindowState:
        """Nothing seen yet."""
        config, like = self._config, self._model.mean
        motion = like.new_zeros(rows, config.context, config.channels)
        return WindowState(motion, like.new_zeros(rows, config.context - 1, config.encoder.outputs))

    def step(
        self,
        heard: Float[Tensor, "b n a"],
        state: WindowState,
        active: Bool[Tensor, " b"],
        noise: Float[Tensor, "b t c"],
    ) -> Float[Tensor, "b t c"]:
        """Normalised frames of one step, from the features of its frames and, in front, earlier ones."""
        gpt, head, config, past = self._model.gpt, self._model.head, self._config, self._config.context - 1
        features, noise = torch.cat([state.sound, heard], 1)[:, -(past + config.step) :], noise.to(state.motion)
        sound = gpt.sound_proj(features)
        shape = (BRANCHES * len(sound), past + config.step, 2 * config.width)
        caches = [(sound.new_empty(shape), sound.new_empty(shape)) for _ in self._blocks]
        self._read(state.motion[:, :-1], sound[:, :past], caches, 0)
        frames = [state.motion[:, -1]]
        for i in range(config.step):
            x = self._read(frames[-1][:, None], sound[:, past + i : past + i + 1], caches, past + i)
            condition = gpt.condition(x[:, 0]).view(-1, BRANCHES, config.condition)
            frames.append(head.sample(condition, noise[:, i], self._schedule, guidance=config.guidance))
        made = torch.stack(frames[1:], 1)
        write_rows(state.motion, torch.cat([state.motion, made], 1)[:, config.step :], active)
        write_rows(state.sound, features[:, config.step :], active)
        return made

    def _read(
        self,
        motion: Float[Tensor, "b t c"],
        sound: Float[Tensor, "b t w"],
        caches: list[tuple[Tensor, Tensor]],
        at: int,
    ) -> Float[Tensor, "r t w"]:
        """Motion goes to both branches, sound to the second; rows are sessions x branches."""
        sound = torch.stack([torch.zeros_like(sound), sound], 1).flatten(0, 1)
        x: Tensor = self._model.gpt.embed(motion).repeat_interleave(BRANCHES, 0)
        for block, cache in zip(self._blocks, caches, strict=True):
            x = block.extend(x, sound, cache, at)
        return x
