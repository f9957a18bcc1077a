"""Run whole files through a generator that hears ahead: the offline, non-causal reference.

Such a generator was trained on sound that is `ahead_chunks` ahead of its motion (`TokenClip.heard_ahead`). A stream
cannot provide that. Here the sounds are known from the start, and the generator alone gets them early. Level control,
silence, settling and everything behind the decoder use the sound that is due, as live. Not in the paper.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.engine.pipeline.bundle import Bundle
from echoavatar.engine.pipeline.pipeline import Pipeline, PipelineState
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, CHUNK_SAMPLES
from echoavatar_lab.models.tokenize import audio_codes


@dataclass
class LookaheadState(PipelineState):
    """A `PipelineState` and the number of chunks that each row has had."""

    chunks: Int[Tensor, " b"]


class LookaheadPipeline(Pipeline):
    """A pipeline of sessions whose whole sound is known. With `ahead_chunks` 0 it equals `Pipeline`."""

    has_lookahead: ClassVar[bool] = True

    def __init__(self, bundle: Bundle, sounds: Mapping[int, Float[np.ndarray, " s"]], *, device: str = "cpu") -> None:
        """`sounds` (24 kHz) are keyed by the seed of the session that will hear them; silence follows each."""
        super().__init__(bundle, device=device)
        self._ahead = bundle.generator.config.ahead_chunks
        self._codes = {0: self._codes_of(np.zeros(CHUNK_SAMPLES, np.float32))}  # for the warm start
        self._warm_row()
        self._codes = {seed: self._codes_of(sound) for seed, sound in sounds.items()}

    def _codes_of(self, sound: Float[np.ndarray, " s"]) -> Int[Tensor, "f l"]:
        """The codes that the generator gets, from the lead-in silence before the sound on."""
        padding = self._lead_in * CHUNK_SAMPLES, self._ahead * CHUNK_SAMPLES + -len(sound) % CHUNK_SAMPLES
        codes = torch.from_numpy(
            audio_codes(self.codec, np.pad(sound, padding), is_leveled=self.level is not None)
        ).long()
        return codes[self._ahead * AUDIO_FRAMES_PER_CHUNK :]

    def init_state(self, rows: int) -> LookaheadState:
        """Sessions that have heard nothing."""
        return LookaheadState(**vars(super().init_state(rows)), chunks=torch.zeros(rows, dtype=torch.int64))

    def encode_audio(
        self, level: Float[Tensor, "b s"], state: PipelineState, active: Bool[Tensor, " b"]
    ) -> Int[Tensor, "b f l"]:
        """Codes of each row's sound `ahead_chunks` later; the sound that is pushed is not used."""
        assert isinstance(state, LookaheadState)
        codes = torch.zeros(len(level), AUDIO_FRAMES_PER_CHUNK, self.codec.codebooks.shape[0], dtype=torch.int64)
        for row in torch.nonzero(active).flatten().tolist():
            first = int(state.chunks[row]) * AUDIO_FRAMES_PER_CHUNK
            codes[row] = self._codes[int(state.seeds[row])][first : first + AUDIO_FRAMES_PER_CHUNK]
            state.chunks[row] += 1
        return codes
