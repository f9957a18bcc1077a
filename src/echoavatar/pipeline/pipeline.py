"""One chunk of audio in, one chunk of motion out, for many sessions at once (paper, Real-time Deployment).

    level control -> codec -> generator -> tokenizer decoder -> post: calm, ground, leash, feet, hands
                  -> face, where the bundle has a face model

Offline and live are the same: a file is a session that is pushed faster. Nothing here depends on the wall clock.
"""

import logging
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ..audio import LevelControl, LevelState, NetworkState
from ..face import FaceState, FaceStream
from ..generator import open_stream
from ..generator.linear import Precision
from ..generator.stream import GeneratorStream, HistoryState, RingState
from ..ik import BodyProfile
from ..nn import StreamState
from ..timing import CHUNK_SAMPLES
from ..tokenizer.body import BodyState
from ..tokenizer.model import DecoderState
from .actions import Directive
from .bundle import Bundle
from .modes import FREE, MotionOptions
from .motion_chunk import MotionChunk
from .post import POST_STAGES, SWITCHES, Post, PostState

_LOG = logging.getLogger(__name__)
Lap = Callable[[str], None]
BIAS = 14.0  # nats that an action of intensity 1 adds to the logits of its codes
LEARNED_BIAS = 12.0  # the same, beside what a generator trained with exemplars does by itself
SILENCE = 0.003  # root mean square of a chunk behind the level control, -50 dBFS, below which nobody is heard
COOL = 0.3  # of the temperature, in silence: at full heat one draw in a hundred leaves the rest, and hands never settle
STAGES = ("level", "face", "codec", "generator", "decoder", *POST_STAGES)


@dataclass
class PipelineState(StreamState):
    """What every stage remembers, and each row's seed."""

    level: LevelState
    codec: NetworkState
    generator: RingState | HistoryState
    decoder: BodyState[DecoderState]
    post: PostState
    face: list[FaceState]  # one, or none without a face model
    seeds: Int[Tensor, " b"]


class Pipeline:
    """The trained parts of a bundle as one streaming machine."""

    def __init__(
        self,
        bundle: Bundle,
        *,
        precision: Precision = "int8",
        stages: Collection[str] = SWITCHES,
        body: BodyProfile | None = None,
    ) -> None:
        """`stages` behind the decoder to run, `body` the character's thickness: see `Post`."""
        self.skeleton = bundle.skeleton
        self.level = LevelControl()
        self.codec = bundle.codec
        self.generator: GeneratorStream[Any] = open_stream(bundle.generator, precision)
        self.tokenizer = bundle.tokenizer
        self.post = Post(bundle.skeleton, stages=stages, body=body)
        self.face = FaceStream(bundle.face) if bundle.face else None
        self.actions = bundle.actions
        self.directive_codes = bundle.generator.config.layout.motion_codes
        self._bias = LEARNED_BIAS if bundle.generator.config.exemplar else BIAS
        self.lap: Lap = _no_lap

    def init_state(self, rows: int) -> PipelineState:
        """Sessions that have heard nothing."""
        return PipelineState(
            self.level.init_state(rows),
            self.codec.init_state(rows),
            self.generator.init_state(rows),
            self.tokenizer.init_decoder(rows),
            self.post.init_state(rows),
            [self.face.init_state(rows)] if self.face else [],
            torch.zeros(rows, dtype=torch.int64),
        )

    def reset(
        self,
        state: PipelineState,
        rows: Bool[Tensor, " b"],
        *,
        seed: int,
        options: MotionOptions = FREE,
    ) -> None:
        """Begin new sessions in these rows."""
        state.reset(rows)
        state.seeds[rows] = seed
        state.post.modes.choose(rows, options)

    def warm_up(self) -> None:
        """Run one step for nobody: the first on a machine compiles the inner loops, which is said if it takes long."""
        patience = threading.Timer(3.0, _LOG.warning, ["compiling for this processor, once; up to a minute"])
        patience.start()
        try:
            self.step(torch.zeros(1, CHUNK_SAMPLES), self.init_state(1), torch.zeros(1, dtype=torch.bool))
        finally:
            patience.cancel()

    def _temperature(self, level: Float[Tensor, "b 6400"]) -> Float[Tensor, " b"]:
        """How freely each row's codes are drawn."""
        is_silent = level.square().mean(1).sqrt() < SILENCE
        full = self.generator.config.temperature
        return torch.where(is_silent, COOL * full, full)

    def directive(self, members: Float[Tensor, "b K"]) -> Directive:
        """What to ask of a step for sets of codes, each with its intensity."""
        return Directive(members, self._bias * members)

    @torch.inference_mode()
    def step(
        self,
        audio: Float[Tensor, "b 6400"],
        state: PipelineState,
        active: Bool[Tensor, " b"],
        *,
        directive: Directive | None = None,
    ) -> list[MotionChunk]:
        """Advance the active rows by one chunk; rows that are not active return what must be ignored.

        `directive` says what actions ask for, row by row.
        After each stage `lap(stage)` is called, so that a benchmark can time them.
        """
        level = self.level.step(audio, state.level, active)
        self.lap("level")
        face = self.face.step(level, state.face[0], active, state.seeds).numpy() if self.face else None
        self.lap("face")
        sounds = self.codec.step(level, state.codec, active)
        self.lap("codec")
        exemplar, bias = (None, None) if directive is None else directive
        codes = self.generator.step(
            sounds,
            state.generator,
            active,
            seeds=state.seeds,
            temperature=self._temperature(level),
            exemplar=exemplar,
            bias=bias,
        )
        self.lap("generator")
        features = self.tokenizer.decode_step(codes, state.decoder, active)
        self.lap("decoder")
        lap = None if self.lap is _no_lap else self.lap
        chunks = self.post.step(features, state.post, active, lap)
        return chunks if face is None else [c._replace(face=f) for c, f in zip(chunks, face, strict=True)]


def _no_lap(stage: str) -> None:
    del stage
