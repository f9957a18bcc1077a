"""Whole files through the streaming engine, by the same code path as live sessions."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import AudioError
from echoavatar.motion.interpolate import StreamInterpolator
from echoavatar.motion.kinematics import Motion, Skeleton
from echoavatar.motion.motion_chunk import MotionChunk, join
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ

from .engine import Engine
from .pipeline import Pipeline


class AnimatedSound(NamedTuple):
    """Motion beside the sound that drove it."""

    motion: Motion
    audio: Float[np.ndarray, " s"]  # 24 kHz mono
    work_s: float  # wall time spent in the engine
    face: Float[np.ndarray, "t 52"] | None = None  # ARKit curves 0..1 beside the motion; None without a model

    @property
    def seconds(self) -> float:
        """The duration."""
        return self.motion.seconds

    @property
    def real_time_factor(self) -> float:
        """Seconds of work per second of sound."""
        return self.work_s / max(self.seconds, 1e-9)

    def __repr__(self) -> str:
        motion, face = self.motion, "no face" if self.face is None else f"a face of {self.face.shape[1]} curves"
        return (
            f"{type(self).__name__} of {self.seconds:.2f} s: {motion.frames} frames at {motion.fps:g} fps, "
            f"{motion.skeleton.joints} joints, {face}, sound at {SAMPLE_RATE_HZ // 1000} kHz"
        )


def animate(
    pipeline: Pipeline,
    blocks: Iterable[Float[np.ndarray, " s"]],
    *,
    seed: int = 0,
    fps: float = FRAME_RATE_HZ,
    options: MotionOptions = FREE,
    words: Iterable[Sequence[Any]] = (),
    progress: Callable[[float], None] | None = None,
) -> AnimatedSound:
    """Motion for a stream of 24 kHz blocks, of exactly the sound's length (rounded up to a frame).

    Frame k shows second k / `fps`, interpolated between the model's 30 frames a second. `words` are as in
    `Session.words`. `progress` receives the seconds of motion made so far.

    Raises:
        AudioError: the sound is empty, or a value is not finite.
        EchoAvatarError: the words are wrong.
        MotionError: `fps` is below 0.1 or above 1000.
    """
    display = None if fps == FRAME_RATE_HZ else StreamInterpolator(fps)
    chunks: list[MotionChunk] = []
    heard: list[Float[np.ndarray, " s"]] = []
    started = time.perf_counter()
    with Engine(pipeline, rewind=0).open(seed=seed, options=options) as session:
        session.words(words)
        for block in blocks:
            heard.append(block)
            session.push(block)
            _collect(session, chunks, progress)
        session.finish()
        _collect(session, chunks, progress)
    audio = np.concatenate(heard) if heard else np.zeros(0, np.float32)
    if not len(audio):
        raise AudioError("there is no sound in it; give a file with at least one sample")
    whole = join(chunks) if display is None else join([*(display.push(chunk) for chunk in chunks), display.finish()])
    work_s = time.perf_counter() - started
    return cut_to_sound(whole, audio, skeleton=pipeline.skeleton, fps=fps, work_s=work_s)


def cut_to_sound(
    whole: MotionChunk, audio: Float[np.ndarray, " s"], *, skeleton: Skeleton, fps: float, work_s: float
) -> AnimatedSound:
    """Cut the motion to the sound's length, and pad the sound to whole frames."""
    frames = math.ceil(len(audio) * fps / SAMPLE_RATE_HZ)
    motion = Motion(skeleton, whole.rotations[:frames], whole.root[:frames], float(fps))
    padded = np.pad(audio, (0, max(0, math.ceil(frames * SAMPLE_RATE_HZ / fps) - len(audio))))
    face = None if whole.face is None else whole.face[:frames]
    return AnimatedSound(motion, padded.astype(np.float32), work_s, face)


def in_blocks(audio: Float[np.ndarray, " s"], seconds: float = 2.0) -> Iterable[Float[np.ndarray, " s"]]:
    """Cut an array into blocks, like a file reader's."""
    size = int(seconds * SAMPLE_RATE_HZ)
    return (audio[start : start + size] for start in range(0, len(audio), size))


def _collect(
    session: Iterable[MotionChunk], chunks: list[MotionChunk], progress: Callable[[float], None] | None
) -> None:
    for chunk in session:
        chunks.append(chunk)
        if progress:
            progress(len(chunks) * len(chunk.root) / FRAME_RATE_HZ)
