"""Motion in time with what is heard: played slower where a stress or a beat asks the body to brake, then caught up.

Not in the paper, whose generator must be in time by itself; ours is small: it gestures and dances, but not on the
beat. A warp model (`warp`) says for each frame how much to brake. Time runs slower there, by which the motion shown
falls behind the motion made, by `LARGEST_LAG` frames at most; between the dips time runs faster until they meet again.
Every pose is one that was made (or between two such), so that feet and hands stay where they were put; only when they
get there changes. No frame of delay is added: with nothing to brake for, motion passes as it is. It is the last stage,
because a smoother behind it would fill the dips again, and no joint turns faster for it than `LARGEST_TURN`.
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
DEPTH = 0.77  # share of its speed that a body loses where it brakes fully
CATCH_UP = 0.13  # of the lag that a frame makes up for
FASTEST = 1.5  # of the speed as made, while catching up
WILLING = 0.6  # of the change of pace that is wanted, what a frame does of it
LARGEST_LAG = 7  # frames
LARGEST_TURN = math.radians(1150) / FRAME_RATE_HZ  # of any joint from frame to frame
LEAST_PACE = 0.2  # where even what was made turns faster


@dataclass
class TimeWarpState(StreamState):
    """Zero is a body that has not moved yet."""

    rotations: Float[Tensor, "b k j 4"]  # the last frames made
    root: Float[Tensor, "b k 3"]
    lag: Float[Tensor, " b"]  # frames that the last one shown was behind
    haste: Float[Tensor, " b"]  # its pace less 1
    seen: Int[Tensor, " b"]  # frames made, as far as they matter


class TimeWarp:
    """The stage behind `Post`."""

    def __init__(self, joints: int) -> None:
        self._joints = joints

    def init_state(self, rows: int) -> TimeWarpState:
        """Nothing made yet."""
        kept = LARGEST_LAG + 1
        past, root = torch.zeros(rows, kept, self._joints, 4), torch.zeros(rows, kept, 3)
        seen = torch.zeros(rows, dtype=torch.int64)
        return TimeWarpState(past, root, torch.zeros(rows), torch.zeros(rows), seen)

    def step(
        self,
        motion: MotionBatch,
        brake: Float[Tensor, "b t"],
        state: TimeWarpState,
        active: Bool[Tensor, " b"],
    ) -> MotionBatch:
        """The next frames as they shall be shown, `brake` is 0 (go on) to 1 (slowest)."""
        kept, frames = state.root.shape[1], brake.shape[1]
        rotations, root = (
            torch.cat([past, torch.from_numpy(new).to(past)], 1)
            for past, new in zip((state.rotations, state.root), motion, strict=True)
        )
        known, travel = rotations.numpy(), root.numpy()
        lags, haste = _lags(brake.numpy(), _turns(known), state)
        at = kept + np.arange(frames) - lags
        low = np.floor(at).astype(np.int64)
        share, high = (at - low).astype(np.float32), np.minimum(low + 1, kept + frames - 1)
        row = np.arange(len(known))[:, None]
        shown = _turned(known[row, low], known[row, high], share[..., None, None])
        moved = travel[row, low] * (1 - share[..., None]) + travel[row, high] * share[..., None]
        write_rows(state.rotations, rotations[:, -kept:], active)
        write_rows(state.root, root[:, -kept:], active)
        write_rows(state.lag, torch.from_numpy(lags[:, -1].astype(np.float32)), active)
        write_rows(state.haste, torch.from_numpy(haste.astype(np.float32)), active)
        write_rows(state.seen, (state.seen + frames).clamp(max=LARGEST_LAG), active)
        return MotionBatch(shown, moved)


def _lags(
    brake: Float[np.ndarray, "b t"], turns: Float[np.ndarray, "b n"], state: TimeWarpState
) -> tuple[Float[np.ndarray, "b t"], Float[np.ndarray, " b"]]:
    """How many frames behind each frame is shown; and the last one's haste."""
    rows, frames = brake.shape
    kept, seen = turns.shape[1] - frames, state.seen.numpy()
    lag, haste, lags = state.lag.numpy().astype(np.float64), state.haste.numpy().astype(np.float64), []
    for frame in range(frames):
        wanted = np.minimum(1 + CATCH_UP * lag, FASTEST) * (1 - DEPTH * brake[:, frame])
        pace = 1 + haste + WILLING * (wanted - 1 - haste)
        next_made = np.floor(kept + frame - 1 - lag).astype(np.int64) + 1
        turn = np.maximum(
            turns[np.arange(rows), next_made],
            turns[np.arange(rows), np.minimum(next_made + 1, kept + frame)],
        )
        pace = np.minimum(pace, np.maximum(LARGEST_TURN / np.maximum(turn, 1e-6), LEAST_PACE))
        shown = np.clip(lag + 1 - pace, 0, np.minimum(seen + frame, LARGEST_LAG))
        lag, haste = shown, lag - shown
        lags.append(lag)
    return np.stack(lags, 1), haste


def _turns(rotations: Float[np.ndarray, "b n j 4"]) -> Float[np.ndarray, "b n"]:
    """By how much (radians) the fastest joint turns on the way to each frame; 0 to the first of a session."""
    aligned = np.abs((rotations[:, 1:] * rotations[:, :-1]).sum(-1)).min(-1)
    turn = 2 * np.arccos(np.minimum(aligned, 1))
    is_first = ~rotations[:, :-1].any((2, 3))
    return np.asarray(np.pad(np.where(is_first, 0, turn), ((0, 0), (1, 0))))


def _turned(
    before: Float[np.ndarray, "b t j 4"],
    after: Float[np.ndarray, "b t j 4"],
    share: Float[np.ndarray, "b t 1 1"],
) -> Float[np.ndarray, "b t j 4"]:
    """Rotations between those of neighbouring frames, the short way; so near that a chord is as good as an arc."""
    side = np.where((before * after).sum(-1, keepdims=True) < 0, -1, 1).astype(np.float32)
    between = before * (1 - share) + side * after * share
    unit = between / np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-9)
    return np.asarray(np.where(share > 0, unit, before))
