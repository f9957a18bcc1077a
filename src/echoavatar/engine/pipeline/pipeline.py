"""The streaming pipeline: audio chunks in, motion chunks out, many sessions at once (paper, Real-time Deployment).

    level control -> codec -> generator -> tokenizer decoder -> rig -> post (`Post`: smoother to hands)
                  -> face, where the bundle has a face model

Offline and live are the same: a file is a session whose audio is pushed faster. Nothing depends on the wall clock.

A generator without a past may begin in mid-dance, and speech takes seconds to calm it. So a session starts with the
state of one that has heard `Runtime.lead_in_s` of silence (not in the paper). That state depends on the bundle alone:
it is computed once for all sessions of a pipeline, and a session's motion still depends only on its sound and seed.
"""

import logging
import math
import threading
from collections.abc import Callable, Collection
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.models.audio import LevelControl, LevelState
from echoavatar.models.face import FaceState, FaceStream
from echoavatar.models.generator.config import Precision
from echoavatar.models.generator.frames import FrameStream
from echoavatar.motion.ik import BodyProfile, Cylinder
from echoavatar.motion.motion_chunk import MotionBatch, MotionChunk, join_batches
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.motion.stages.post import POST_STAGES, Post, PostState
from echoavatar.nn import StreamState
from echoavatar.nn.device import find_device
from echoavatar.nn.kernels import compilations
from echoavatar.nn.torch_backend import torch_backend
from echoavatar.stored import Rounded
from echoavatar.timing import CHUNK_FRAMES, SAMPLE_RATE_HZ

from .actions import Directive
from .bundle import FACE, Bundle, Part
from .foreign_rig import Output, RigAdapter, RigState

_LOG = logging.getLogger(__name__)
OnStage = Callable[[str], None]
BIAS = 14.0  # nats that an action of intensity 1 adds to the logits of its codes
LEARNED_BIAS = 12.0  # the same for a generator that was trained with exemplars
STAGES = ("level", "face", "codec", "generator", "decoder", "rig", *POST_STAGES)


@dataclass
class PipelineState(StreamState):
    """The states of all stages, and each row's seed."""

    level: LevelState
    codec: StreamState
    generator: StreamState
    decoder: StreamState
    post: PostState
    rig: list[RigState]  # one where the bundle was trained on another rig
    face: list[FaceState]  # one, or none without a face model
    seeds: Int[np.ndarray, " b"]


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
        self.device = find_device(device)
        self._level_state = LevelControl().init_state
        self.level = LevelControl() if runtime.level_control else None
        parts, sizes = bundle.parts, bundle.sizes
        self.codec = self._run(parts["codec"], "step", "init_state")
        self.decoder = self._run(parts["tokenizer"], "decode_step", "init_decoder")
        self.generator = self._generator(bundle, precision)
        chosen = runtime.stages if stages is None else stages
        self.post = Post(self.skeleton, stages=chosen, body=body)
        self.cylinder = Cylinder(self.skeleton, body) if runtime.cylinder and "hands" not in chosen else None
        self.additions = frozenset(runtime.session)  # additions of sessions, see `SessionCore`
        self.runtime = runtime.label  # how it runs, for headers
        self.face = self._face(parts[FACE]) if FACE in parts else None
        self.actions = bundle.actions
        self.chunk = bundle.chunk
        self.has_manner = sizes.manner  # whether `step` takes a manner
        self.has_opening = sizes.opening is not None  # whether the generator's window is full from the start
        self.directive_codes = len(sizes.directed) * sizes.layout.motion_codes
        own_bias = LEARNED_BIAS if sizes.exemplar else BIAS
        self._bias = own_bias if sizes.example_bias is None else sizes.example_bias
        is_exported = self.device == "cpu" and all(part.graph for name, part in parts.items() if name != "generator")
        is_compiled = isinstance(self.generator, FrameStream)
        self.rows_are_apart = is_exported and is_compiled  # a row's sums are the same in every batch; torch's are not
        self.on_stage: OnStage = lambda stage: None
        self._lead_in = math.ceil(runtime.lead_in_s * SAMPLE_RATE_HZ / self.chunk.samples)
        self._warm_start: PipelineState | None = None
        self._warm_lock = threading.Lock()

    def _run(self, part: Part, step: str, init_state: str) -> Any:
        """A part's graph on a CPU if it has one, else its module."""
        if self.device == "cpu" and part.graph:
            return part.graph
        module = part.module
        return torch_backend(f"the {part.name}").open_step(module, self.device, step, init_state)

    def _generator(self, bundle: Bundle, precision: Precision | None) -> Any:
        """The compiled stream, which needs no torch, for the depth order on a CPU; else the lab's module."""
        if self.device == "cpu" and precision != "bfloat16" and bundle.sizes.sequence == "depth":
            return FrameStream(bundle.sizes, bundle.parts["generator"].arrays(), rounds=precision != "float32")
        own: Precision = "int8" if self.device == "cpu" else "bfloat16"
        module = bundle.generator
        return torch_backend("the generator").open_generator(module, self.device, precision or own)

    def _face(self, part: Part) -> FaceStream:
        """Compiled loops and the graph of its audio encoder; torch without a graph or with a memory but `ring`."""
        has_idle = "blinks" in self.additions
        if part.graph is None or part.config.memory != "ring":
            return part.module.stream(has_idle=has_idle)  # type: ignore[no-any-return]
        stored = part.arrays().items()
        weights = {name: value.floats() if isinstance(value, Rounded) else value for name, value in stored}
        return FaceStream(part.config, weights, part.graph, has_idle=has_idle)

    def init_state(self, rows: int) -> PipelineState:
        """Sessions that have heard nothing."""
        return PipelineState(
            self._level_state(rows),
            self.codec.init_state(rows),
            self.generator.init_state(rows),
            self.decoder.init_state(rows),
            self.post.init_state(rows),
            [self.rig.init_state(rows)] if self.rig else [],
            [self.face.init_state(rows)] if self.face else [],
            np.zeros(rows, np.int64),
        )

    def reset(
        self, state: PipelineState, rows: Bool[np.ndarray, " b"], *, seed: int, options: MotionOptions = FREE
    ) -> None:
        """Start new sessions in these rows: at the origin, after `Runtime.lead_in_s` of silence."""
        state.overwrite(rows, self._warm_row())
        state.seeds[rows] = seed
        state.post.modes.choose(rows, options)

    def _warm_row(self) -> PipelineState:
        """The state of a new session, to be copied and not changed. `warm_up` makes it, so that no session waits."""
        with self._warm_lock:
            self._warm_start = self._warm_start or self._after_silence()
            return self._warm_start

    def _after_silence(self) -> PipelineState:
        """One row whose models have heard the lead-in silence; the stages behind the decoder have seen nothing."""
        state, everyone = self.init_state(1), np.ones(1, np.bool_)
        with ThreadPoolExecutor(1) as beside:
            for _ in range(self._lead_in):
                self._features(np.zeros((1, self.chunk.samples), np.float32), state, everyone, beside=beside)
        return state

    def restart_generator(self, state: PipelineState, rows: Bool[np.ndarray, " b"]) -> None:
        """Give these rows the generator state of a new session; the body stays where it is."""
        state.generator.overwrite(rows, self._warm_row().generator)

    def warm_up(self) -> None:
        """Run a step without a session, and make the warm start.

        The first run on a machine compiles the loops, and a log message says so.
        """
        everyone, state = np.ones(1, np.bool_), self.init_state(1)
        state.post.modes.choose(everyone, MotionOptions(leash_m=1.0))  # so that the leash is compiled too
        told = "compiling for this processor, once: about a minute, more on a busy machine"
        with compilations(lambda: _LOG.warning(told)):
            self.step(np.zeros((1, self.chunk.samples), np.float32), state, ~everyone)
            self._warm_row()

    def encode_audio(
        self, level: Float[np.ndarray, "b s"], state: PipelineState, active: Bool[np.ndarray, " b"]
    ) -> Int[np.ndarray, "b f l"]:
        """The audio codes that the generator gets in this step."""
        codes: np.ndarray = self.codec.step(level, state.codec, active)
        return codes

    def directive(self, members: Float[np.ndarray, "b K"]) -> Directive:
        """The directive for one set of codes per row, given as intensities."""
        return Directive(members, self._bias * members)

    def step(
        self,
        audio: Float[np.ndarray, "b s"],
        state: PipelineState,
        active: Bool[np.ndarray, " b"],
        *,
        directive: Directive | None = None,
        manner: Float[np.ndarray, "b m"] | None = None,
        hands: Float[np.ndarray, "b 3"] | None = None,
        beside: Executor | None = None,
    ) -> list[MotionChunk]:
        """Advance the active rows by one chunk; ignore what inactive rows return.

        A chunk has `chunk.samples` samples (paper: 6,400, ours 3,200) and gives `chunk.frames` frames (8, 4).
        The smoother works on eight frames at most, so a longer chunk passes the stages behind the decoder in pieces.
        Row by row, `directive` holds the requests of actions, `manner` the numbers of `TOLD`, and `hands` the sizes of
        the arms' moves (`stillness.WHOLE`). `on_stage` is called after each stage. A thread of `beside` makes the face,
        which does not depend on the body, while this one makes the body.
        """
        features, face = self._features(audio, state, active, directive, manner, beside)
        pieces = np.split(features, range(CHUNK_FRAMES, features.shape[1], CHUNK_FRAMES), 1)
        motion = join_batches([self.post.step(piece, state.post, active, self.on_stage, hands) for piece in pieces])
        if self.cylinder:
            motion = MotionBatch(self.cylinder.resolve(motion.rotations), motion.root)
        return motion.split(face)

    def _features(
        self,
        audio: Float[np.ndarray, "b s"],
        state: PipelineState,
        active: Bool[np.ndarray, " b"],
        directive: Directive | None = None,
        manner: Float[np.ndarray, "b m"] | None = None,
        beside: Executor | None = None,
    ) -> tuple[Float[np.ndarray, "b t c"], Float[np.ndarray, "b t 52"] | None]:
        """What the models make of a chunk: motion before the stages behind the decoder, and the face."""
        level = self.level.step(audio, state.level, active) if self.level else audio
        self.on_stage("level")
        if beside is None:
            face = self._faces(level, state, active)
            return self._bodies(level, state, active, directive, manner), face
        making = beside.submit(self._faces, level, state, active)
        try:
            features = self._bodies(level, state, active, directive, manner)
        finally:
            face = making.result()  # after a fault, too: nobody may write to the state any more
        return features, face

    def _faces(
        self, level: Float[np.ndarray, "b s"], state: PipelineState, active: Bool[np.ndarray, " b"]
    ) -> Float[np.ndarray, "b t 52"] | None:
        face = self.face.step(level, state.face[0], active, state.seeds) if self.face else None
        self.on_stage("face")
        return face

    def _bodies(
        self,
        level: Float[np.ndarray, "b s"],
        state: PipelineState,
        active: Bool[np.ndarray, " b"],
        directive: Directive | None,
        manner: Float[np.ndarray, "b m"] | None,
    ) -> Float[np.ndarray, "b t c"]:
        sounds = self.encode_audio(level, state, active)
        self.on_stage("codec")
        exemplar, bias = directive or (None, None)
        told = {"exemplar": exemplar, "bias": bias, "manner": manner}
        codes = self.generator.step(sounds, state.generator, active, seeds=state.seeds, **told)
        self.on_stage("generator")
        features: np.ndarray = self.decoder.step(codes, state.decoder, active)
        self.on_stage("decoder")
        if self.rig is not None:
            features = self.rig.step(features, state.rig[0], active)
        self.on_stage("rig")
        return features
