"""Many sounds animated in one batch."""

import time
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from echoavatar.engine import AnimatedSound, Engine
from echoavatar.engine.offline import cut_to_sound
from echoavatar.engine.pipeline import Pipeline
from echoavatar.errors import AudioError
from echoavatar.motion.motion_chunk import join
from echoavatar.motion.stages.modes import FREE, MotionOptions
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.progress import Progress


def animate_many(
    pipeline: Pipeline,
    sounds: Sequence[Float[np.ndarray, " s"]],
    *,
    seeds: Sequence[int],
    options: MotionOptions = FREE,
    progress: Progress | None = None,
) -> list[AnimatedSound]:
    """Motion and face for several sounds (24 kHz) in one batch: the same as one by one, in less time.

    `options` are those of each session. `progress` receives the chunks done and the chunks in all. The seconds of work
    are shared out by length of sound.
    Raises AudioError if one of the sounds is empty, or a value is not finite.
    """
    if silent := [number for number, sound in enumerate(sounds) if not len(sound)]:
        raise AudioError(f"there is no sound in number {silent[0]}; give at least one sample")
    started = time.perf_counter()
    engine = Engine(pipeline, seats=max(1, len(sounds)), rewind=0, workers=0)
    sessions = [engine.open(seed=seed, options=options) for _, seed in zip(sounds, seeds, strict=True)]
    for session, sound in zip(sessions, sounds, strict=True):
        session.push(sound)
        session.finish()
    total = sum(-(-len(sound) // engine.chunk.samples) for sound in sounds)
    done = 0
    while moved := engine.tick():
        done += moved
        if progress:
            progress(done, total)
    per_sample = (time.perf_counter() - started) / max(1, sum(len(sound) for sound in sounds))
    return [
        cut_to_sound(
            join(list(session)), sound, skeleton=engine.skeleton, fps=FRAME_RATE_HZ, work_s=len(sound) * per_sample
        )
        for session, sound in zip(sessions, sounds, strict=True)
    ]
