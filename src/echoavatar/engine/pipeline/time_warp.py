"""The beat-aligned time warp: motion is played slower at stresses and beats, and catches up afterwards.

The generator gestures and dances, but not exactly on the beat. A warp model (`models.warp`) gives for each frame how
much to brake. Time runs slower there, so the motion shown falls behind the motion made, by at most `LARGEST_LAG`
frames. Between the dips time runs faster until the lag is gone. With nothing to brake for, motion passes unchanged and
without delay.

Every pose shown is one that was made, or lies between two such. Feet and hands therefore stay where they were put; only
the time at which they arrive changes. The warp is the last stage, because a smoother behind it would fill the dips
again. It makes no joint rotate faster than `LARGEST_ROTATION`. Not in the paper.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.motion.motion_chunk import MotionBatch
from echoavatar.nn import StreamState, write_rows
from echoavatar.timing import FRAME_RATE_HZ

WARP = "warp"  # the stage's name
DEPTH = 0.77  # share of the pace that full braking removes
CATCH_UP = 0.13  # share of the lag that a frame recovers
FASTEST = 1.5  # the greatest pace while catching up; 1 is as made
PACE_STEP = 0.6  # share of the wanted change of pace that a frame makes
LARGEST_LAG = 7  # frames
LARGEST_ROTATION = math.radians(1150) / FRAME_RATE_HZ  # of any joint from frame to frame
LEAST_PACE = 0.2  # the least pace where the motion as made is faster than `LARGEST_ROTATION`


@dataclass
class TimeWarpState(StreamState):
    """Zero is a body that has not moved yet."""

    rotations: Float[Tensor, "b k j 4"]  # the last frames made
    root: Float[Tensor, "b k 3"]
    lag: Float[Tensor, " b"]  # of the last frame shown, in frames
    pace_offset: Float[Tensor, " b"]  # pace of the last frame shown, minus 1
    seen: Int[Tensor, " b"]  # frames made, counted up to `LARGEST_LAG`


class TimeWarp:
    """The last stage, behind `Post`."""

    def __init__(self, joints: int) -> None:
        self._joints = joints

    def init_state(self, rows: int) -> TimeWarpState:
        """Nothing made yet."""
        kept = LARGEST_LAG + 1
        past, root = torch.zeros(rows, kept, self._joints, 4), torch.zeros(rows, kept, 3)
        seen = torch.zeros(rows, dtype=torch.int64)
        return TimeWarpState(past, root, torch.zeros(rows), torch.zeros(rows), seen)

    def step(
        self, motion: MotionBatch, brake: Float[Tensor, "b t"], state: TimeWarpState, active: Bool[Tensor, " b"]
    ) -> MotionBatch:
        """The next frames to show; `brake` is 0 (as made) to 1 (slowest)."""
        kept, frames = state.root.shape[1], brake.shape[1]
        rotations, root = (
            torch.cat([past, torch.from_numpy(new).to(past)], 1)
            for past, new in zip((state.rotations, state.root), motion, strict=True)
        )
        known, travel = rotations.numpy(), root.numpy()
        lags, pace_offset = _lags(brake.numpy(), _largest_rotations(known), state)
        at = kept + np.arange(frames) - lags
        low = np.floor(at).astype(np.int64)
        share, high = (at - low).astype(np.float32), np.minimum(low + 1, kept + frames - 1)
        row = np.arange(len(known))[:, None]
        shown = _between(known[row, low], known[row, high], share[..., None, None])
        moved = travel[row, low] * (1 - share[..., None]) + travel[row, high] * share[..., None]
        write_rows(state.rotations, rotations[:, -kept:], active)
        write_rows(state.root, root[:, -kept:], active)
        write_rows(state.lag, torch.from_numpy(lags[:, -1].astype(np.float32)), active)
        write_rows(state.pace_offset, torch.from_numpy(pace_offset.astype(np.float32)), active)
        write_rows(state.seen, (state.seen + frames).clamp(max=LARGEST_LAG), active)
        return MotionBatch(shown, moved)


def _lags(
    brake: Float[np.ndarray, "b t"], rotations: Float[np.ndarray, "b n"], state: TimeWarpState
) -> tuple[Float[np.ndarray, "b t"], Float[np.ndarray, " b"]]:
    """The lag of each frame, and the last one's pace offset; `rotations` are those of `_largest_rotations`."""
    rows, frames = brake.shape
    kept, seen = rotations.shape[1] - frames, state.seen.numpy()
    lag, pace_offset = (value.numpy().astype(np.float64) for value in (state.lag, state.pace_offset))
    lags = []
    for frame in range(frames):
        wanted = np.minimum(1 + CATCH_UP * lag, FASTEST) * (1 - DEPTH * brake[:, frame])
        pace = 1 + pace_offset + PACE_STEP * (wanted - 1 - pace_offset)
        next_made = np.floor(kept + frame - 1 - lag).astype(np.int64) + 1
        rotation = np.maximum(
            rotations[np.arange(rows), next_made], rotations[np.arange(rows), np.minimum(next_made + 1, kept + frame)]
        )
        pace = np.minimum(pace, np.maximum(LARGEST_ROTATION / np.maximum(rotation, 1e-6), LEAST_PACE))
        new_lag = np.clip(lag + 1 - pace, 0, np.minimum(seen + frame, LARGEST_LAG))
        lag, pace_offset = new_lag, lag - new_lag
        lags.append(lag)
    return np.stack(lags, 1), pace_offset


def _largest_rotations(rotations: Float[np.ndarray, "b n j 4"]) -> Float[np.ndarray, "b n"]:
    """The rotation (radians) of the fastest joint from the frame before to each frame; 0 for a session's first."""
    aligned = np.abs((rotations[:, 1:] * rotations[:, :-1]).sum(-1)).min(-1)
    angle = 2 * np.arccos(np.minimum(aligned, 1))
    is_first = ~rotations[:, :-1].any((2, 3))
    return np.asarray(np.pad(np.where(is_first, 0, angle), ((0, 0), (1, 0))))


def _between(
    before: Float[np.ndarray, "b t j 4"], after: Float[np.ndarray, "b t j 4"], share: Float[np.ndarray, "b t 1 1"]
) -> Float[np.ndarray, "b t j 4"]:
    """Rotations between those of neighbouring frames: normalised linear interpolation, since the angles are small."""
    side = np.where((before * after).sum(-1, keepdims=True) < 0, -1, 1).astype(np.float32)
    between = before * (1 - share) + side * after * share
    unit = between / np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-9)
    return np.asarray(np.where(share > 0, unit, before))
