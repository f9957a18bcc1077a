"""Trembling and jumps taken out without delay, and a bound on how fast a joint may turn.

Sampled codes carry noise that a decoder cannot tell from motion, and every latent of 4 frames may begin with a small
step; the first frames of a chunk need not continue the last ones. Each chunk is replaced by the smoothest path that
leaves the frames already shown as they were going and is drawn to the decoded rotations, the more the later in the
chunk (a Whittaker-Henderson smoother with a fixed beginning): it minimises

    sum_k  ((k + 1) / t)^LATE |y_k - x_k|^2  +  STIFFNESS s_k |third difference of (shown, y) that ends in y_k|^2

over the unit quaternions' four numbers, which is one small matrix; and likewise the root's travel. s_k is `BEND` where
a latent begins and 1 elsewhere: there, and only there, acceleration may change at little cost, so that a step is bent
over a whole latent and a chunk is as smooth at its border as within. No joint turns faster than `FASTEST`. The three
numbers make the least jerk at equal distance from what was decoded that leaves no place of a chunk rougher than others
(`docs/results/post.md`). The paper smooths nothing; a model sampled at temperature 1 shakes without it.
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
from ..nn.octet import (
    LANES,
    behind,
    exact,
    fused,
    inner,
    is_any,
    load,
    root,
    scratch,
    size,
    spread,
    store,
    where,
)
from ..timing import FRAMES_PER_MOTION_TOKEN
from .pose import Array, PoseLanes

FASTEST = math.radians(1000)  # per second
LATE = 10  # power by which the end of a chunk counts more than its beginning
STIFFNESS = 2.0  # 0 shows what was decoded
BEND = 0.01  # of the stiffness, what is left where a latent begins
SHOWN = 3  # frames that a third difference reaches back
_LEAST = F(1e-12)


@dataclass
class CalmState(StreamState):
    """The last eight rotations shown, of which three are looked at, and travels; all zero: none yet."""

    shown: Float[Tensor, "b j 4 8"]
    travel: Float[Tensor, "b 3 8"]


class Calm:
    """A smoother of joint rotations and of the root's travel, streaming by the chunk; the first begins at rest."""

    def __init__(self, joints: int, stiffness: float = STIFFNESS) -> None:
        self._joints, self._stiffness = joints, stiffness

    def init_state(self, rows: int) -> CalmState:
        """Nothing shown yet."""
        return CalmState(torch.zeros(rows, self._joints, 4, LANES), torch.zeros(rows, 3, LANES))

    def step(self, pose: PoseLanes, state: CalmState, active: Bool[Array, " b"]) -> None:
        """Rotations and travel of a chunk, smoothed in place; `active` rows remember them."""
        smoother, cosine = self.numbers(pose.frames, pose.fps)
        shown, travel = state.shown.numpy(), state.travel.numpy()
        smooth(pose.turns, pose.root, pose.frames, shown, travel, active, smoother, cosine)

    def numbers(self, frames: int, fps: float) -> tuple[Float[Array, "11 8"], np.float32]:
        """What `smooth` wants for a chunk of so many frames: the smoother's matrix and the bound's cosine."""
        return _numbers(frames, fps, self._stiffness)


@cache
def _numbers(frames: int, fps: float, stiffness: float) -> tuple[Float[Array, "11 8"], np.float32]:
    return _smoother(frames, stiffness), F(math.cos(FASTEST / fps / 2))


def _smoother(frames: int, stiffness: float) -> Float[Array, "11 8"]:
    """What each of the frames shown and of a chunk (3 + 8) adds to the smoothed chunk: the minimum, solved once."""
    third = np.diff(np.eye(SHOWN + frames), n=3, axis=0)
    past, own = third[:, :SHOWN], third[:, SHOWN:]
    place = np.arange(frames)
    weight = np.diag(((place + 1) / frames) ** LATE)
    stiff = stiffness * np.where(place % FRAMES_PER_MOTION_TOKEN == 0, BEND, 1.0)[:, None]
    right = np.concatenate([-own.T @ (stiff * past), weight], 1)
    solved = np.linalg.solve(weight + own.T @ (stiff * own), right)
    shares = np.zeros((SHOWN + LANES, LANES), np.float32)
    shares[: SHOWN + frames] = np.pad(solved.T, ((0, 0), (0, LANES - frames)), mode="edge")
    return shares


@exact()
def smooth(turns, roots, frames, shown, travel, active, smoother, cosine):  # type: ignore[no-untyped-def]
    """All rows; `cosine` is that of half the angle that a joint may turn in a frame."""
    joints = turns.shape[1]
    begun, spare = scratch((1, joints, 4, LANES)), scratch((2, LANES))
    shares = (
        (load(smoother, (0,)), load(smoother, (1,)), load(smoother, (2,))),
        (
            load(smoother, (3,)),
            load(smoother, (4,)),
            load(smoother, (5,)),
            load(smoother, (6,)),
            load(smoother, (7,)),
            load(smoother, (8,)),
            load(smoother, (9,)),
            load(smoother, (10,)),
        ),
    )
    for row in range(turns.shape[0]):
        is_new = True
        for k in range(4):
            is_new &= shown[row, 0, k, LANES - 1] == ZERO
        if is_new:
            for joint in range(joints):
                for k in range(4):
                    store(begun, (0, joint, k), spread(turns[row, joint, k, 0], load(turns, (row, joint, k))))
        past, at = (begun, 0) if is_new else (shown, row)
        for joint in range(joints):  # loop after loop: many joints are under way, and none waits for another
            _one_hemisphere(turns, row, joint, past, at, spare)
        for joint in range(joints):
            for k, number in enumerate(_smoothed(turns, row, joint, past, at, shares)):
                store(turns, (row, joint, k), number)
        for joint in range(joints):
            w, x, y, z = quaternion_at(turns, row, joint)
            share = ONE / root(fused(z, z, fused(y, y, fused(x, x, w * w))))
            for k, number in enumerate((w, x, y, z)):
                store(turns, (row, joint, k), number * share)
            if is_any(size(_along(turns, row, joint, past, at)) < cosine):
                _slow_down(turns, row, joint, frames, past, at, cosine, spare)
            if active[row]:
                _remember(turns, row, joint, frames, past, at, shown)
        for axis in range(3):
            before = load(travel, (row, axis))
            if is_new:
                before = spread(roots[row, axis, 0], before)
            store(spare, (0,), before)
            path = spread(ZERO, before)
            for frame in range(SHOWN):
                path += spare[0, LANES - SHOWN + frame] * load(smoother, (frame,))
            for frame in range(LANES):
                path += roots[row, axis, frame] * load(smoother, (SHOWN + frame,))
            store(roots, (row, axis), path)
            if active[row]:
                for frame in range(LANES):
                    then = frames + frame
                    travel[row, axis, frame] = (
                        spare[0, then] if then < LANES else roots[row, axis, then - LANES]
                    )


@inner()
def _remember(turns, row, joint, frames, past, at, shown):  # type: ignore[no-untyped-def]
    """The last eight of a joint's path."""
    for k in range(4):
        if frames == LANES:
            store(shown, (row, joint, k), load(turns, (row, joint, k)))
        else:
            for frame in range(LANES):
                then = frames + frame
                last = past[at, joint, k, then] if then < LANES else turns[row, joint, k, then - LANES]
                shown[row, joint, k, frame] = last


@inner()
def _along(turns, row, joint, past, at):  # type: ignore[no-untyped-def]
    """Cosine of half the angle by which a joint turns from the frame before to each."""
    w, x, y, z = quaternion_at(turns, row, joint)
    last = LANES - 1
    along = fused(x, behind(x, past[at, joint, 1, last]), w * behind(w, past[at, joint, 0, last]))
    return fused(z, behind(z, past[at, joint, 3, last]), fused(y, behind(y, past[at, joint, 2, last]), along))


@inner()
def _one_hemisphere(turns, row, joint, past, at, spare):  # type: ignore[no-untyped-def]
    """Signs chosen, in place, so that no quaternion points away from the one before it."""
    along = _along(turns, row, joint, past, at)
    if not is_any(along < ZERO):
        return
    store(spare, (0,), where(along < ZERO, spread(-ONE, along), ONE))
    sign = ONE
    for frame in range(LANES):
        sign *= spare[0, frame]
        for k in range(4):
            turns[row, joint, k, frame] *= sign


@inner()
def _smoothed(turns, row, joint, past, at, shares):  # type: ignore[no-untyped-def]
    """A joint's four numbers, not yet of length one."""
    of_past, of_own = shares
    w = x = y = z = spread(ZERO, of_past[0])
    for frame, share in enumerate(of_past):
        then = LANES - SHOWN + frame
        w, x = fused(past[at, joint, 0, then], share, w), fused(past[at, joint, 1, then], share, x)
        y, z = fused(past[at, joint, 2, then], share, y), fused(past[at, joint, 3, then], share, z)
    for frame, share in enumerate(of_own):
        w, x = fused(turns[row, joint, 0, frame], share, w), fused(turns[row, joint, 1, frame], share, x)
        y, z = fused(turns[row, joint, 2, frame], share, y), fused(turns[row, joint, 3, frame], share, z)
    return w, x, y, z


@inner()
def _slow_down(turns, row, joint, frames, past, at, cosine, spare):  # type: ignore[no-untyped-def]
    """A joint that turns by more than twice the angle of this cosine in a frame follows its path more slowly."""
    sine = F(math.sqrt(ONE - cosine * cosine))
    for k in range(4):
        spare[0, k] = past[at, joint, k, LANES - 1]
    for frame in range(frames):
        along = ZERO
        for k in range(4):
            spare[1, k] = turns[row, joint, k, frame]
            along += spare[0, k] * spare[1, k]
        share = -ONE if along < ZERO else ONE
        along = abs(along)
        if along < cosine:
            aside, length = ZERO, ZERO
            for k in range(4):
                spare[1, k] = share * spare[1, k] - spare[0, k] * along
                aside += spare[1, k] * spare[1, k]
            share = sine / max(F(math.sqrt(aside)), _LEAST)
            for k in range(4):
                spare[1, k] = spare[0, k] * cosine + spare[1, k] * share
                length += spare[1, k] * spare[1, k]
            share = ONE / F(math.sqrt(length))
        for k in range(4):
            spare[0, k] = spare[1, k] * share
            turns[row, joint, k, frame] = spare[0, k]
