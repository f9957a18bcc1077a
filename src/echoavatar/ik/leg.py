"""A leg of two bones brought to a target by turning knee and hip; the foot keeps its direction in the world.

The geometry of `kinematics.two_bone`, for the live path: eight frames at once in compiled loops (`nn.octet`), in the
root's frame. The knee bends about its own hinge, the X axis of the lower leg; then the whole leg swings by the least
rotation.
"""

from typing import NamedTuple

import numpy as np

from ..kinematics import Skeleton
from ..kinematics.octets import (
    conjugate,
    cross,
    dot,
    minus,
    multiply,
    place_at,
    plus,
    quaternion_at,
    rotation_at,
    turned,
    turned_back,
)
from ..kinematics.two_bone import REACH
from ..nn.compiled import HALF, ONE, ZERO, F
from ..nn.octet import inner, least, most, root, size, spread, store, where
from .chains import Chains

_TINY, _LEAST_LENGTH = F(1e-9), F(1e-12)


class Legs(NamedTuple):
    """Both legs of a rig as tables for compiled loops, left first."""

    joints: np.ndarray  # (2, 4) thigh, shin, foot, toes (the foot again, where there are no toes)
    slots: np.ndarray  # (2, 4) the same joints in the chains
    above: np.ndarray  # (2, k) joints between the root and the thigh, from above
    lower: np.ndarray  # (2, 3) the ankle in the shin's frame, metres
    lengths: (
        np.ndarray
    )  # (2, 3) sum of the squared bones, least and greatest square of the way from hip to ankle


def legs_of(skeleton: Skeleton, chains: Chains | None = None) -> Legs | None:
    """Both legs of a rig whose `feet` are known (ankle and toes, left and right); None for other rigs.

    `chains` must hold the feet; by default they hold nothing else.
    """
    feet = skeleton.config.feet
    if len(feet) != 4:
        return None
    ankles, toes = [feet[0], feet[2]], [feet[1], feet[3]]
    shins = [skeleton.parents[joint] for joint in ankles]
    thighs = [skeleton.parents[joint] if joint > 0 else -1 for joint in shins]
    if min(thighs) <= 0:
        return None
    above = [_above(skeleton, joint) for joint in thighs]
    if len(above[0]) != len(above[1]):
        return None
    chains = chains or Chains(skeleton, list(feet))
    joints = np.array([thighs, shins, ankles, toes], np.int64).T.copy()
    offsets = skeleton.offsets.numpy().astype(np.float32)
    a, b = (np.linalg.norm(offsets[bones], axis=1) for bones in (shins, ankles))
    lengths = np.stack([a * a + b * b, np.square(np.abs(a - b) + 1e-4), np.square(REACH * (a + b))], 1)
    slots = np.array([[chains.slot[joint] for joint in leg] for leg in joints.tolist()], np.int64)
    middle = np.array(above, np.int64).reshape(2, -1)
    return Legs(joints, slots, middle, offsets[ankles], lengths.astype(np.float32))


def _above(skeleton: Skeleton, joint: int) -> list[int]:
    chain: list[int] = []
    while (joint := skeleton.parents[joint]) > 0:
        chain.insert(0, joint)
    return chain


@inner()
def bend(legs, side, turns, frames, row, aside):  # type: ignore[no-untyped-def]
    """Turn thigh, shin and foot in `turns` so that the ankle goes by `aside`, as far as the leg reaches.

    `turns` (b, j, 4, 8) are changed in this row; `frames` (b, c, 12, 8) are those of the pose before; `aside` is in the
    root's frame.
    """
    zero = spread(ZERO, aside[0])
    above = (spread(ONE, zero), zero, zero, zero)  # world rotation of what carries the thigh
    for k in range(legs.above.shape[1]):
        above = multiply(above, quaternion_at(turns, row, legs.above[side, k]))
    thigh_joint, shin_joint, foot_joint = legs.joints[side, 0], legs.joints[side, 1], legs.joints[side, 2]
    thigh = multiply(above, quaternion_at(turns, row, thigh_joint))
    shin, foot = quaternion_at(turns, row, shin_joint), quaternion_at(turns, row, foot_joint)
    fold, swing = _solve(legs, side, frames, row, aside)
    foot_world = multiply(multiply(thigh, shin), foot)
    thigh, shin = multiply(swing, thigh), multiply(shin, fold)
    foot = multiply(conjugate(multiply(thigh, shin)), foot_world)
    thigh = multiply(conjugate(above), thigh)
    for k, number in enumerate(thigh):
        store(turns, (row, thigh_joint, k), number)
    for k, number in enumerate(shin):
        store(turns, (row, shin_joint, k), number)
    for k, number in enumerate(foot):
        store(turns, (row, foot_joint, k), number)


@inner()
def _solve(legs, side, frames, row, aside):  # type: ignore[no-untyped-def]
    """How the shin folds, in its own frame, and how the whole leg then swings, in the root's: quaternions."""
    hip, knee = place_at(frames, row, legs.slots[side, 0]), place_at(frames, row, legs.slots[side, 1])
    ankle, turn = place_at(frames, row, legs.slots[side, 2]), rotation_at(frames, row, legs.slots[side, 1])
    x, y, z = legs.lower[side, 0], legs.lower[side, 1], legs.lower[side, 2]
    upper, way = minus(knee, hip), minus(plus(ankle, aside), hip)
    asked = dot(way, way)
    far = least(most(asked, legs.lengths[side, 1]), legs.lengths[side, 2])
    seen = turned_back(turn, upper)
    # the knee's angle t solves cosine cos t + sine sin t = wanted
    cosine, sine = y * seen[1] + z * seen[2], y * seen[2] - z * seen[1]
    wanted = (far - legs.lengths[side, 0]) * HALF - x * seen[0]
    length = most(root(cosine * cosine + sine * sine), _TINY)
    share = least(most(wanted / length, F(-1)), ONE)
    rest = root((ONE - share) * (ONE + share))
    cos, sin = (cosine * share - sine * rest) / length, (sine * share + cosine * rest) / length
    # half that angle, of either sign: from the larger of its cosine and sine
    greater = root(most((ONE + size(cos)) * HALF, _TINY))
    smaller = sin / (greater + greater)
    is_near = cos > ZERO
    zero = spread(ZERO, cos)
    fold = (where(is_near, greater, smaller), where(is_near, smaller, greater), zero, zero)
    folded = (spread(x, cos), y * cos - z * sin, y * sin + z * cos)
    reached = plus(turned(turn, folded), upper)
    sizes = root(asked * far)  # of both vectors, multiplied: what is reached has the length asked for
    along, across = dot(reached, way) + sizes, cross(reached, way)
    short = ONE / root(most(F(2) * sizes * along, _LEAST_LENGTH))
    return fold, (along * short, across[0] * short, across[1] * short, across[2] * short)
