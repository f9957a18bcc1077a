"""`echoavatar bench post`: what the stages behind the decoder cost, stage by stage, without any model.

The motion is synthetic: a body that steps, waves and brings its hands to the body, with noise as sampled codes leave
it, so that smoother, feet and hands all have work to do; sessions are free (no leash). Before every chunk the caches
are emptied, as the models do in a session (`between`).
"""

import math
import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from echoavatar.bench.face import evict_caches
from echoavatar.motion.kinematics import HUMANOID, to_features
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle
from echoavatar.motion.stages.post import POST_STAGES, Post
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ

WARM_UP = 10
CLIP_CHUNKS = 60


@dataclass(frozen=True)
class PostReport:
    """Milliseconds per session and chunk, median: each stage and all together, for one session and for many."""

    one_ms: dict[str, float]
    many_ms: dict[str, float]
    sessions: int

    @property
    def summary(self) -> dict[str, float]:
        """The totals."""
        return {"post_ms": self.one_ms["all"], "sessions": self.sessions, "ms_per_session": self.many_ms["all"]}


def bench_post(*, chunks: int = 600, sessions: int = 64) -> PostReport:
    """Time `chunks` chunks of one session, and a tenth as many of `sessions` at once."""
    clip, many = restless(CLIP_CHUNKS * CHUNK_FRAMES), max(10, chunks // 10)
    return PostReport(_stages_ms(clip, 1, chunks), _stages_ms(clip, sessions, many), sessions)


def _stages_ms(clip: Float[np.ndarray, "t c"], sessions: int, chunks: int) -> dict[str, float]:
    """Median milliseconds of each stage and of all, per session."""
    between, post = evict_caches(), Post(HUMANOID)
    state, active = post.init_state(sessions), np.ones(sessions, np.bool_)
    pieces = np.split(clip, len(clip) // CHUNK_FRAMES)
    times = []
    for step in range(WARM_UP + chunks):
        batch = np.stack([pieces[(step + 7 * row) % len(pieces)] for row in range(sessions)])
        between()
        ends = [time.perf_counter()]
        post.step(batch, state, active, lambda stage, ends=ends: ends.append(time.perf_counter()))  # type: ignore[misc]
        times.append([*np.diff(ends), ends[-1] - ends[0]])
    medians = 1000 * np.median(times[WARM_UP:], axis=0) / sessions
    return {name: round(float(ms), 4) for name, ms in zip((*POST_STAGES, "all"), medians, strict=True)}


def restless(frames: int) -> Float[np.ndarray, "t c"]:
    """Features of a body with work for every stage; repeats without a step after `frames` frames."""
    phase = np.arange(frames) * (2 * math.pi / frames)
    turns = 0.03 * np.random.default_rng(0).standard_normal((frames, HUMANOID.joints, 3))
    inwards = np.zeros((HUMANOID.joints, 3))
    beats = round(frames / FRAME_RATE_HZ * 0.8)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wave = np.sin(beats * phase + sign)
        turns[:, HUMANOID.index(f"{side}UpperArm"), 2] -= sign * (1.05 + 0.25 * wave)
        inwards[HUMANOID.index(f"{side}UpperArm"), 1] = -sign * 0.9
        turns[:, HUMANOID.index(f"{side}LowerArm"), 1] -= sign * (1.3 + 0.9 * wave)
        knee = 0.15 + 0.5 * np.maximum(sign * np.sin(beats * phase), 0)
        turns[:, HUMANOID.index(f"{side}UpperLeg"), 0] -= knee
        turns[:, HUMANOID.index(f"{side}LowerLeg"), 0] += 2 * knee
        turns[:, HUMANOID.index(f"{side}Foot"), 0] -= knee
    root = np.stack([0.05 * np.sin(beats * phase), np.full(frames, 0.94), np.zeros(frames)], 1)
    rotations = matrix_from_axis_angle(inwards) @ matrix_from_axis_angle(turns)
    return to_features(HUMANOID, rotations, root).astype(np.float32)
