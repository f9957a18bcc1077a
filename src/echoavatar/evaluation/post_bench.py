"""`echoavatar bench post`: what holding a body together costs, stage by stage, without any model.

The motion is synthetic: a body that steps, waves and brings its hands to the body, with noise as sampled codes leave
it, so that smoothing, foot lock, stepping and hand guard all have work to do; sessions are free (no leash). Times are
of the processor, one thread: what other processes take away does not count, what they push out of the caches does.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ..kinematics import HUMANOID, to_features
from ..kinematics.rotations import matrix_from_axis_angle
from ..pipeline.post import POST_STAGES, Post
from ..timing import CHUNK_FRAMES, FRAME_RATE_HZ

WARM_UP = 10
CLIP_CHUNKS = 60


@dataclass(frozen=True)
class PostReport:
    """Processor milliseconds per chunk, p50, p95 and p99: each stage and all together, one session and many."""

    one_ms: dict[str, tuple[float, float, float]]
    many_ms: dict[str, tuple[float, float, float]]
    summary: dict[str, float]


def bench_post(
    *, chunks: int = 600, sessions: int = 64, progress: Callable[[int, int], None] | None = None
) -> PostReport:
    """Time one session and a batch of `sessions`."""
    post, clip = Post(HUMANOID), restless(CLIP_CHUNKS * CHUNK_FRAMES)
    rounds = {1: chunks, sessions: max(20, chunks // 8)}
    total, done, rows = sum(rounds.values()), 0, {}
    for count, steps in rounds.items():
        laps = _time(post, clip, count, steps)
        rows[count] = {stage: _percentiles(values[WARM_UP:]) for stage, values in laps.items()}
        done += steps
        if progress:
            progress(done, total)
    one, many = rows[1], rows[sessions]
    summary = {
        "post_ms_p50": one["all"][0],
        "post_ms_p95": one["all"][1],
        "post_ms_p5": one["p5"][0],
        "sessions": float(sessions),
        "batch_ms_p50": many["all"][0],
        "batch_over_one": many["all"][0] / one["all"][0],
        "batch_over_one_p5": many["p5"][0] / one["p5"][0],
        "ms_per_session_in_batch": many["all"][0] / sessions,
    }
    return PostReport(one, many, {key: round(value, 3) for key, value in summary.items()})


def _time(post: Post, clip: Float[Tensor, "t c"], rows: int, steps: int) -> dict[str, list[float]]:
    state, active = post.init_state(rows), torch.ones(rows, dtype=torch.bool)
    pieces = clip.tensor_split(len(clip) // CHUNK_FRAMES)
    laps: dict[str, list[float]] = {stage: [] for stage in (*POST_STAGES, "all")}
    last = [0.0]

    def lap(stage: str) -> None:
        now = time.thread_time()
        laps[stage].append((now - last[0]) * 1000)
        last[0] = time.thread_time()

    with torch.inference_mode():
        for step in range(steps + WARM_UP):
            batch = torch.stack([pieces[(step + 7 * row) % len(pieces)] for row in range(rows)])
            began = last[0] = time.thread_time()
            post.step(batch, state, active, lap)
            laps["all"].append((time.thread_time() - began) * 1000)
    laps["p5"] = [float(np.percentile(laps["all"][WARM_UP:], 5))] * (WARM_UP + 1)
    return laps


def restless(frames: int, seed: int = 0) -> Float[Tensor, "t c"]:
    """Features of a body with work for every stage; repeats without a step after `frames` frames."""
    generator = torch.Generator().manual_seed(seed)
    phase = torch.arange(frames) * (2 * math.pi / frames)
    turns, inwards = torch.zeros(frames, HUMANOID.joints, 3), torch.zeros(HUMANOID.joints, 3)
    beats = round(frames / FRAME_RATE_HZ * 0.8)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wave = torch.sin(beats * phase + sign)
        turns[:, HUMANOID.index(f"{side}UpperArm"), 2] = -sign * (1.05 + 0.25 * wave)
        inwards[HUMANOID.index(f"{side}UpperArm"), 1] = -sign * 0.9
        turns[:, HUMANOID.index(f"{side}LowerArm"), 1] = -sign * (1.3 + 0.9 * wave)
        knee = 0.15 + 0.5 * (sign * torch.sin(beats * phase)).clamp_min(0)
        turns[:, HUMANOID.index(f"{side}UpperLeg"), 0] = -knee
        turns[:, HUMANOID.index(f"{side}LowerLeg"), 0] = 2 * knee
        turns[:, HUMANOID.index(f"{side}Foot"), 0] = -knee
    turns += 0.03 * torch.randn(turns.shape, generator=generator)
    root = torch.zeros(frames, 3)
    root[:, 0], root[:, 1] = 0.05 * torch.sin(beats * phase), 0.94
    rotations = matrix_from_axis_angle(inwards) @ matrix_from_axis_angle(turns)
    return to_features(HUMANOID, rotations, root)


def _percentiles(values: list[float]) -> tuple[float, float, float]:
    p50, p95, p99 = np.percentile(values, [50, 95, 99])
    return float(p50), float(p95), float(p99)
