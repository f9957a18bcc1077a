"""Trembling and jumps taken out without delay, and a bound on how fast a joint may turn.

Sampled codes carry noise that a decoder cannot tell from motion, and every latent of 4 frames may begin with a small
step; the first frames of a chunk need not continue the last ones. Each chunk is replaced by the smoothest path that
leaves the frames already shown as they were going and is drawn to the decoded rotations, the more the later in the
chunk (a Whittaker-Henderson smoother with a fixed beginning): it minimises

    sum_k  ((k + 1) / t)^4 |y_k - x_k|^2  +  STIFFNESS |third differences of (shown, y)|^2

over the unit quaternions' four numbers, which is one small matrix. No joint turns faster than `FASTEST`. The paper
smooths nothing; a model sampled at temperature 1 shakes without it.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..kinematics.octets import quaternion_at
from ..nn import StreamState
from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import LANES, behind, exact, inner, is_any, load, root, size, spread, store, where
from .pose import Array, PoseLanes

FASTEST = math.radians(1000)  # per second
STIFFNESS = 2.0  # 0 shows what was decoded
SHOWN = 3  # frames that a third difference reaches back
_LEAST = F(1e-12)


@dataclass
class CalmState(StreamState):
    """The last rotations shown; all zero: none yet."""

    shown: Float[Tensor, "b j 4 3"]


class Calm:
    """A smoother of joint rotations, streaming by the chunk; the first chunk begins at rest."""

    def __init__(self, joints: int, stiffness: float = STIFFNESS) -> None:
        self._joints, self._stiffness = joints, stiffness

    def init_state(self, rows: int) -> CalmState:
        """Nothing shown yet."""
        return CalmState(torch.zeros(rows, self._joints, 4, SHOWN))

    def step(self, pose: PoseLanes, state: CalmState, active: Bool[Array, " b"]) -> None:
        """Rotations of a chunk, smoothed in place; `active` rows remember them."""
        smoother = _smoother(pose.frames, self._stiffness)
        cosine = F(math.cos(FASTEST / pose.fps / 2))
        _calm(pose.turns, pose.frames, state.shown.numpy(), active, smoother, cosine)


@cache
def _smoother(frames: int, stiffness: float) -> Float[Array, "s 8"]:
    """What each of the frames shown and of a chunk (3 + t) adds to the smoothed chunk: the minimum, solved once."""
    third = np.diff(np.eye(SHOWN + frames), n=3, axis=0)
    past, own = third[:, :SHOWN], third[:, SHOWN:]
    weight = np.diag(((np.arange(frames) + 1) / frames) ** 4)
    right = np.concatenate([-stiffness * own.T @ past, weight], 1)
    solved = np.linalg.solve(weight + stiffness * own.T @ own, right)
    filled = np.pad(solved.T, ((0, 0), (0, LANES - frames)), mode="edge")
    return np.ascontiguousarray(filled, np.float32)


@exact()
def _calm(turns, frames, shown, active, smoother, cosine):  # type: ignore[no-untyped-def]
    """All rows; `cosine` is that of half the angle that a joint may turn in a frame."""
    past = np.empty((4, SHOWN), F)
    for row in range(turns.shape[0]):
        is_new = True
        for k in range(4):
            is_new &= shown[row, 0, k, 0] == ZERO
        for joint in range(turns.shape[1]):
            for k in range(4):
                for frame in range(SHOWN):
                    past[k, frame] = turns[row, joint, k, 0] if is_new else shown[row, joint, k, frame]
            _one_hemisphere(turns, row, joint, past)
            w, x = _smoothed(turns, row, joint, 0, past, smoother), _smoothed(turns, row, joint, 1, past, smoother)
            y, z = _smoothed(turns, row, joint, 2, past, smoother), _smoothed(turns, row, joint, 3, past, smoother)
            length = root(w * w + x * x + y * y + z * z)
            w, x, y, z = w / length, x / length, y / length, z / length
            for k, number in enumerate((w, x, y, z)):
                store(turns, (row, joint, k), number)
            before = behind(w, past[0, 2]), behind(x, past[1, 2]), behind(y, past[2, 2]), behind(z, past[3, 2])
            near = size(w * before[0] + x * before[1] + y * before[2] + z * before[3])
            if is_any(near < cosine):
                _slow_down(turns[row, joint], frames, past[:, SHOWN - 1], cosine)
            if active[row]:
                for k in range(4):
                    for back in range(SHOWN):
                        frame = frames - SHOWN + back
                        last = turns[row, joint, k, frame] if frame >= 0 else past[k, SHOWN + frame]
                        shown[row, joint, k, back] = last


@inner()
def _one_hemisphere(turns, row, joint, past):  # type: ignore[no-untyped-def]
    """Signs chosen, in place, so that no quaternion points away from the one before it."""
    w, x, y, z = quaternion_at(turns, row, joint)
    along = w * behind(w, past[0, 2]) + x * behind(x, past[1, 2])
    along += y * behind(y, past[2, 2]) + z * behind(z, past[3, 2])
    if not is_any(along < ZERO):
        return
    signs = np.empty((1, LANES), F)
    store(signs, (0,), where(along < ZERO, spread(-ONE), spread(ONE)))
    sign = ONE
    for frame in range(LANES):
        sign *= signs[0, frame]
        for k in range(4):
            turns[row, joint, k, frame] *= sign


@inner()
def _smoothed(turns, row, joint, k, past, smoother):  # type: ignore[no-untyped-def]
    """One of a joint's four numbers."""
    total = past[k, 0] * load(smoother, (0,)) + past[k, 1] * load(smoother, (1,))
    total += past[k, 2] * load(smoother, (2,))
    for frame in range(smoother.shape[0] - SHOWN):
        total += turns[row, joint, k, frame] * load(smoother, (SHOWN + frame,))
    return total


@inner()
def _slow_down(turns, frames, start, cosine):  # type: ignore[no-untyped-def]
    """A joint (4, 8) that turns by more than twice the angle of this cosine in a frame follows its path more slowly."""
    sine = F(math.sqrt(ONE - cosine * cosine))
    last = np.empty(4, F)
    for k in range(4):
        last[k] = start[k]
    for frame in range(frames):
        along = ZERO
        for k in range(4):
            along += last[k] * turns[k, frame]
        sign = -ONE if along < ZERO else ONE
        along = abs(along)
        if along < cosine:
            aside = ZERO
            for k in range(4):
                turns[k, frame] = sign * turns[k, frame] - last[k] * along
                aside += turns[k, frame] * turns[k, frame]
            share, length = sine / max(F(math.sqrt(aside)), _LEAST), ZERO
            for k in range(4):
                turns[k, frame] = last[k] * cosine + turns[k, frame] * share
                length += turns[k, frame] * turns[k, frame]
            sign = ONE / F(math.sqrt(length))
        for k in range(4):
            turns[k, frame] *= sign
            last[k] = turns[k, frame]
