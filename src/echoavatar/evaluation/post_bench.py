"""`echoavatar bench post`: what holding a body together costs, stage by stage, without any model.

The motion is synthetic: a body that steps, waves and brings its hands to the body, with noise as sampled codes leave
it, so that smoothing, foot lock, stepping and hand guard all have work to do; sessions are free (no leash). One session
and the batch take turns, so that neighbours on the machine slow both alike. Before every chunk the caches are taken, as
the models do in a session (`between`); what a chunk costs right after another is told, too ("again"). Times are of the
processor: what other processes take away does not count, what they push out of the caches does; and of the wall, of
which the least is told, too, as the time of a machine that has nothing else to do.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ..kinematics import HUMANOID, to_features
from ..kinematics.rotations import matrix_from_axis_angle
from ..pipeline.post import POST_STAGES, Post
from ..timing import CHUNK_FRAMES, FRAME_RATE_HZ
from .between import other_models

WARM_UP = 10
CLIP_CHUNKS = 60
_TURNS = 10  # chunks of one session to one of the batch


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
    one, many = _chunks(post, clip, 1), _chunks(post, clip, sessions)
    for _ in range(WARM_UP):
        next(one), next(many)
    rounds = max(20, chunks // _TURNS)
    alone, batch = list[dict[str, float]](), list[dict[str, float]]()
    for done in range(rounds):
        alone += [next(one) for _ in range(_TURNS)]
        batch.append(next(many))
        if progress:
            progress(done + 1, rounds)
    alone_ms, batch_ms = _by_stage(alone), _by_stage(batch)
    p50, wall, best, again = (
        [float(of(times[kind])) for times in (alone_ms, batch_ms)]
        for kind, of in (("all", np.median), ("wall", np.median), ("wall", np.min), ("again", np.median))
    )
    summary = {
        "post_ms_p50": p50[0],
        "post_ms_p95": float(np.percentile(alone_ms["all"], 95)),
        "post_wall_ms_p50": wall[0],
        "post_wall_ms_least": best[0],
        "post_again_wall_ms_p50": again[0],
        "sessions": float(sessions),
        "batch_ms_p50": p50[1],
        "batch_wall_ms_p50": wall[1],
        "batch_wall_ms_least": best[1],
        "batch_again_wall_ms_p50": again[1],
        "batch_over_one": p50[1] / p50[0],
        "batch_over_one_wall": wall[1] / wall[0],
        "batch_over_one_wall_least": best[1] / best[0],
        "batch_over_one_again": again[1] / again[0],
        "ms_per_session_in_batch": p50[1] / sessions,
    }
    rows = [
        {stage: _percentiles(times[stage]) for stage in (*POST_STAGES, "all")}
        for times in (alone_ms, batch_ms)
    ]
    return PostReport(rows[0], rows[1], {key: round(value, 3) for key, value in summary.items()})


def _chunks(post: Post, clip: Float[Tensor, "t c"], rows: int) -> Iterator[dict[str, float]]:
    """Milliseconds of the processor, stage by stage and of all, and of the wall; chunk by chunk."""
    between = other_models()
    state, active = post.init_state(rows), torch.ones(rows, dtype=torch.bool)
    pieces: tuple[Tensor, ...] = clip.tensor_split(len(clip) // CHUNK_FRAMES)
    for step in count():
        batch = torch.stack([pieces[(step + 7 * row) % len(pieces)] for row in range(rows)])
        between()
        wall, began = time.perf_counter(), time.process_time()
        post.step(batch, state, active)
        times = {"all": time.process_time() - began, "wall": time.perf_counter() - wall}
        wall = time.perf_counter()
        post.step(batch, state, active)
        times["again"] = time.perf_counter() - wall
        ends = dict[str, float]()

        def lap(stage: str, ends: dict[str, float] = ends) -> None:
            ends[stage] = time.process_time()

        between()
        began = time.process_time()
        post.step(batch, state, active, lap)
        starts = [began, *(ends[stage] for stage in POST_STAGES)]
        times |= {stage: ends[stage] - start for stage, start in zip(POST_STAGES, starts, strict=False)}
        yield {name: 1000 * seconds for name, seconds in times.items()}


def _by_stage(chunks: list[dict[str, float]]) -> dict[str, Float[np.ndarray, " n"]]:
    return {name: np.array([chunk[name] for chunk in chunks]) for name in chunks[0]}


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


def _percentiles(values: Float[np.ndarray, " n"]) -> tuple[float, float, float]:
    p50, p95, p99 = np.percentile(values, [50, 95, 99])
    return float(p50), float(p95), float(p99)
