"""The streaming pipeline: audio chunks in, motion chunks out, many sessions at once (paper, Real-time Deployment).

    level control -> codec -> generator -> tokenizer decoder -> rig -> post (`Post`: smoother to hands)
                  -> face, where the bundle has a face model

Offline and live are the same: a file is a session whose audio is pushed faster. Nothing depends on the wall clock.

A generator without a past may begin in mid-dance, and speech takes seconds to calm it. So a session starts with the
state of one that has heard `Runtime.lead_in_s` of silence (not in the paper). One row computes that state, once for all
sessions of a pipeline. It depends on the bundle alone, so a session's motion still depends only on its own sound and
seed.
"""

import logging
import math
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import LevelControl, LevelState, NetworkState
from echoavatar.models.face import FaceState, FaceStream
from echoavatar.models.generator import open_stream
from echoavatar.models.generator.linear import Precision
from echoavatar.models.generator.stream import DepthStream, FrameState, GeneratorStream, HistoryState, RingState
from echoavatar.models.tokenizer import BodyState
from echoavatar.motion.ik import BodyProfile, Cylinder
from echoavatar.motion.motion_chunk import MotionBatch, MotionChunk, join_batches
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.motion.stages.post import POST_STAGES, Post, PostState
from echoavatar.nn import StreamingModule, StreamState
from echoavatar.nn.exported import ExportedState, ExportedStep
from echoavatar.nn.kernels import compilations
from echoavatar.timing import CHUNK_FRAMES, SAMPLE_RATE_HZ

from .actions import Directive
from .bundle import Bundle
from .foreign_rig import Output, RigAdapter, RigState

_LOG = logging.getLogger(__name__)
OnStage = Callable[[str], None]
BIAS = 14.0  # nats that an action of intensity 1 adds to the logits of its codes
LEARNED_BIAS = 12.0  # the same for a generator that was trained with exemplars
STAGES = ("level", "face", "codec", "generator", "decoder", "rig", *POST_STAGES)


def copy_row(state: StreamState, rows: Bool[Tensor, " b"], source: StreamState) -> None:
    """Overwrite the chosen rows of `state` with the one row of `source`."""
    for tensor, row in zip(state.tensors(), source.tensors(), strict=True):
        tensor[rows] = row


def find_device(name: str) -> torch.device:
    """`cpu`, `cuda`, a certain one such as `cuda:1`, or `auto`: the GPU where there is one.

    Raises EchoAvatarError if there is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    kind, _, number = name.partition(":")
    if kind == "cpu" and not number:
        return torch.device("cpu")
    if kind != "cuda" or (number and not number.isdecimal()):
        raise EchoAvatarError(f"no device {name!r}; say cpu, cuda, cuda:1 or auto")
    found = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(number or 0) >= found:
        why = f"there are {found} here" if found else _why_none()
        raise EchoAvatarError(f"no CUDA device {number or 0}: {why}; --device cpu runs everywhere")
    return torch.device(name)


def _why_none() -> str:
    if torch.version.cuda is None:
        return "this is torch's CPU build (pip install torch from the index of a CUDA build)"
    return "no GPU, or no driver for it (see nvidia-smi)"


@dataclass
class PipelineState(StreamState):
    """The states of all stages, and each row's seed."""

    level: LevelState
    codec: NetworkState | ExportedState
    generator: RingState | HistoryState | FrameState
    decoder: BodyState | ExportedState
    post: PostState
    rig: list[RigState]  # one where the bundle was trained on another rig
    face: list[FaceState]  # one, or none without a face model
    seeds: Int[Tensor, " b"]


class Pipeline:
    """The trained parts of a bundle as one streaming machine."""

    def __init__(
        self,
        bundle: Bundle,
        *,
        precision: Precision | None = None,
        stages: Collection[str] | None = None,
        body: BodyProfile | None = None,
        output: Output = "humanoid",
        device: str = "cpu",
    ) -> None:
        """Build the pipeline of a bundle.

        Args:
            bundle: the trained parts.
            precision: of the generator's weights; None is int8 on a CPU and bfloat16 elsewhere.
            stages: those to run behind the decoder; None is the bundle's choice.
            body: the character's thickness, see `Post`.
            output: for a bundle trained on another rig: `native` keeps its bones, `humanoid` retargets.
            device: where codec, generator and tokenizer run (see `find_device`); the face and the stages behind the
                decoder are compiled loops on the host.

        Raises:
            EchoAvatarError: there is no such device.
        """
        runtime = bundle.runtime
        self.rig = RigAdapter(runtime.rig, bundle.skeleton, output) if runtime.rig else None
        self.skeleton = self.rig.skeleton if self.rig else bundle.skeleton
        self.level = LevelControl() if runtime.level_control else None
        self.device = find_device(device)
        steps = bundle.steps if self.device.type == "cpu" else {}
        self.codec: StreamingModule[Any] | ExportedStep = steps.get("codec") or bundle.codec.to(self.device)
        own_precision: Precision = "int8" if self.device.type == "cpu" else "bfloat16"
        self.generator: GeneratorStream[Any] = open_stream(bundle.generator.to(self.device), precision or own_precision)
        tokenizer, decoder = bundle.tokenizer.to(self.device), steps.get("tokenizer")
        self._init_decoder: Callable[[int], Any] = decoder.init_state if decoder else tokenizer.init_decoder
        self.decode: Callable[[Tensor, Any, Tensor], Tensor] = decoder.step if decoder else tokenizer.decode_step
        chosen = runtime.stages if stages is None else stages
        self.post = Post(self.skeleton, stages=chosen, body=body)
        self.cylinder = Cylinder(self.skeleton, body) if runtime.cylinder and "hands" not in chosen else None
        self.additions = frozenset(runtime.session)  # additions of sessions, see `SessionCore`
        self.runtime = runtime.label  # how it runs, for headers
        has_idle, ear = "blinks" in self.additions, steps.get("face")
        self.face = FaceStream(bundle.face, has_idle=has_idle, ear=ear) if bundle.face else None
        self.actions = bundle.actions
        config = bundle.generator.config
        self.chunk = bundle.chunk
        self.has_manner = config.manner  # whether `step` takes one
        self.directive_codes = len(config.directed) * config.layout.motion_codes
        own_bias = LEARNED_BIAS if config.exemplar else BIAS
        self._bias = own_bias if config.example_bias is None else config.example_bias
        is_exported = {"codec", "tokenizer", *(["face"] if self.face else [])} <= steps.keys()
        is_compiled = isinstance(self.generator, DepthStream) and precision != "bfloat16"
        self.rows_are_apart = is_exported and is_compiled  # a row's sums are the same in every batch; torch's are not
        self.on_stage: OnStage = lambda stage: None
        self._lead_in = math.ceil(runtime.lead_in_s * SAMPLE_RATE_HZ / self.chunk.samples)
        self._warm_start: PipelineState | None = None
        self._warm_lock = threading.Lock()

    def init_state(self, rows: int) -> PipelineState:
        """Sessions that have heard nothing."""
        return PipelineState(
            LevelControl().init_state(rows),
            self.codec.init_state(rows),
            self.generator.init_state(rows),
            self._init_decoder(rows),
            self.post.init_state(rows),
            [self.rig.init_state(rows)] if self.rig else [],
            [self.face.init_state(rows)] if self.face else [],
            torch.zeros(rows, dtype=torch.int64),
        )

    def reset(
        self, state: PipelineState, rows: Bool[Tensor, " b"], *, seed: int, options: MotionOptions = FREE
    ) -> None:
        """Start new sessions in these rows: at the origin, after `Runtime.lead_in_s` of silence."""
        copy_row(state, rows, self._warm_row())
        state.seeds[rows] = seed
        state.post.modes.choose(rows.numpy(), options)

    def _warm_row(self) -> PipelineState:
        """The state of a new session, to be copied and not changed. `warm_up` makes it, so that no session waits."""
        with self._warm_lock:
            self._warm_start = self._warm_start or self._after_silence()
            return self._warm_start

    def _after_silence(self) -> PipelineState:
        """One row that has heard the lead-in silence. Stages behind the decoder, and the position, are reset."""
        state, everyone = self.init_state(1), torch.ones(1, dtype=torch.bool)
        for _ in range(self._lead_in):
            self.step(torch.zeros(1, self.chunk.samples), state, everyone)
        state.post.reset(everyone)
        return state

    def restart_generator(self, state: PipelineState, rows: Bool[Tensor, " b"]) -> None:
        """Give these rows the generator state of a new session; the body stays where it is."""
        copy_row(state.generator, rows, self._warm_row().generator)

    def warm_up(self) -> None:
        """Run a step without a session, and make the warm start.

        The first run on a machine compiles the loops, and a log message says so.
        """
        everyone, state = torch.ones(1, dtype=torch.bool), self.init_state(1)
        state.post.modes.choose(everyone.numpy(), MotionOptions(leash_m=1.0))  # so that the leash is compiled too
        with compilations(lambda: _LOG.warning("compiling for this processor, once; up to a minute")):
            self.step(torch.zeros(1, self.chunk.samples), state, ~everyone)
            self._warm_row()

    def encode_audio(
        self, level: Float[Tensor, "b s"], state: PipelineState, active: Bool[Tensor, " b"]
    ) -> Int[Tensor, "b f l"]:
        """The audio codes that the generator gets in this step."""
        return self.codec.step(level.to(self.device), state.codec, active.to(self.device))

    def directive(self, members: Float[Tensor, "b K"]) -> Directive:
        """The directive for one set of codes per row, given as intensities."""
        return Directive(members, self._bias * members)

    @torch.inference_mode()
    def step(
        self,
        audio: Float[Tensor, "b s"],
        state: PipelineState,
        active: Bool[Tensor, " b"],
        *,
        directive: Directive | None = None,
        manner: Float[Tensor, "b m"] | None = None,
    ) -> list[MotionChunk]:
        """Advance the active rows by one chunk; ignore what inactive rows return.

        A chunk has `chunk.samples` samples (6,400 in our bundles and the paper) and gives `chunk.frames` frames (8).
        The smoother works on eight frames at a time, so a longer chunk passes the stages behind the decoder in pieces.
        Row by row, `directive` holds the requests of actions, and `manner` the numbers of `Manner`. Benchmarks set
        `on_stage`, called after each stage.
        """
        level = self.level.step(audio, state.level, active) if self.level else audio
        self.on_stage("level")
        face = self.face.step(level, state.face[0], active, state.seeds).numpy() if self.face else None
        self.on_stage("face")
        sounds = self.encode_audio(level, state, active)
        self.on_stage("codec")
        there = self.device
        exemplar, bias = (None, None) if directive is None else (part.to(there) for part in directive)
        codes = self.generator.step(
            sounds.to(there),
            state.generator,
            active.to(there),
            seeds=state.seeds.to(there),
            exemplar=exemplar,
            bias=bias,
            manner=None if manner is None else manner.to(there),
        )
        self.on_stage("generator")
        features, on = self.decode(codes, state.decoder, active.to(there)).cpu().numpy(), active.numpy()
        self.on_stage("decoder")
        if self.rig is not None:
            features = self.rig.step(features, state.rig[0], on)
        self.on_stage("rig")
        pieces = np.split(features, range(CHUNK_FRAMES, features.shape[1], CHUNK_FRAMES), 1)
        motion = join_batches([self.post.step(piece, state.post, on, self.on_stage) for piece in pieces])
        if self.cylinder:
            motion = MotionBatch(self.cylinder.resolve(motion.rotations), motion.root)
        return motion.split(face)
