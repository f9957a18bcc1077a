"""A leg of two bones brought to a target by turning knee and hip; the foot keeps its direction in the world.

The geometry of `kinematics.two_bone`, for the live path: numpy, components first, quaternions, in the root's frame.
The knee bends about its own hinge, the X axis of the lower leg; then the whole leg swings by the least rotation.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..kinematics import Skeleton, lanes
from ..kinematics.two_bone import REACH

Array = np.ndarray


class Leg(NamedTuple):
    """Joints of both legs, left first."""

    thighs: list[int]
    shins: list[int]
    feet: list[int]
    toes: list[int]  # the feet again, where there are no toes
    between: tuple[tuple[int, ...], tuple[int, ...]]  # joints between the root and the thighs, from above


def legs_of(skeleton: Skeleton) -> Leg | None:
    """Both legs of a rig whose `feet` are known (ankle and toes, left and right); None for other rigs."""
    feet = skeleton.config.feet
    if len(feet) != 4:
        return None
    ankles, toes = [feet[0], feet[2]], [feet[1], feet[3]]
    shins = [skeleton.parents[joint] for joint in ankles]
    thighs = [skeleton.parents[joint] if joint > 0 else -1 for joint in shins]
    if min(thighs) <= 0:
        return None
    left, right = (_above(skeleton, joint) for joint in thighs)
    return Leg(thighs, shins, ankles, toes, (left, right)) if len(left) == len(right) else None


def _above(skeleton: Skeleton, joint: int) -> tuple[int, ...]:
    chain: list[int] = []
    while (joint := skeleton.parents[joint]) > 0:
        chain.insert(0, joint)
    return tuple(chain)


class LegReach:
    """Both legs of a rig, brought to targets."""

    def __init__(self, skeleton: Skeleton, legs: Leg) -> None:
        self._joints = np.array([legs.thighs, legs.shins, legs.feet])
        self._between = [list(pair) for pair in zip(*legs.between, strict=True)]
        offsets = skeleton.offsets.numpy().astype(np.float32)
        self._lower = offsets[legs.feet].T[..., None]  # in the shin's frame
        a, b = (np.linalg.norm(offsets[joints], axis=1)[:, None] for joints in (legs.shins, legs.feet))
        self._squares = a * a + b * b
        self._nearest, self._farthest = np.square(np.abs(a - b) + 1e-4), np.square(REACH * (a + b))

    def bend(
        self,
        turns: Float[Array, "4 j n"],
        shins: Float[Array, "3 3 f n"],
        places: Float[Array, "3 3 f n"],
        target: Float[Array, "3 f n"],
    ) -> None:
        """Turn thighs, shins and feet, in place, so that the ankles meet their targets as far as the legs reach.

        Args:
            turns: parent-relative quaternions of the whole rig, changed.
            shins: world rotations of the shins, in the root's frame.
            places: positions of hips, knees and ankles (second axis) in the root's frame.
            target: where the ankles should be.
        """
        legs = turns[:, self._joints]  # (4, thigh shin foot, side, n)
        above = self._above(turns)
        if above is not None:
            legs[:, 0] = lanes.multiply(above, legs[:, 0])
        first, second = np.empty((2, 4, 2, *legs.shape[2:]), np.float32)
        self._solve(shins, places, target, fold=second[:, 0], swing=first[:, 0])
        first[:, 1] = legs[:, 0]
        whole = lanes.multiply(first, legs[:, :2])  # the swung thigh; thigh and shin
        first[:, 0], first[:, 1], second[:, 1] = legs[:, 1], whole[:, 1], legs[:, 2]
        both = lanes.multiply(first, second)  # the bent shin; the foot in the world, as it was
        legs[:, 2] = lanes.multiply(lanes.conjugate(lanes.multiply(whole[:, 0], both[:, 0])), both[:, 1])
        legs[:, 0], legs[:, 1] = whole[:, 0], both[:, 0]
        if above is not None:
            legs[:, 0] = lanes.multiply(lanes.conjugate(above), legs[:, 0])
        turns[:, self._joints] = legs

    def _above(self, turns: Float[Array, "4 j n"]) -> Float[Array, "4 f n"] | None:
        """World rotation of what carries the thighs, in the root's frame; None where that is the root."""
        world = None
        for pair in self._between:
            world = turns[:, pair] if world is None else lanes.multiply(world, turns[:, pair])
        return world

    def _solve(
        self,
        shins: Float[Array, "3 3 f n"],
        places: Float[Array, "3 3 f n"],
        target: Float[Array, "3 f n"],
        *,
        fold: Float[Array, "4 f n"],
        swing: Float[Array, "4 f n"],
    ) -> None:
        """How the shin folds, in its own frame, and how the whole leg then swings, in the root's."""
        x, y, z = self._lower
        upper, way = places[:, 1] - places[:, 0], target - places[:, 0]
        asked = lanes.dot(way, way)
        far = np.minimum(np.maximum(asked, self._nearest), self._farthest)
        seen = lanes.apply_inverse(shins, upper)
        cosine, sine = y * seen[1] + z * seen[2], y * seen[2] - z * seen[1]
        wanted = (far - self._squares) * 0.5 - x * seen[0]
        share = wanted / np.maximum(np.hypot(cosine, sine), 1e-9)
        half = (np.arctan2(sine, cosine) + np.arccos(np.minimum(np.maximum(share, -1), 1))) * 0.5
        fold[0], fold[1], fold[2:] = np.cos(half), np.sin(half), 0
        cos, sin = 1 - 2 * np.square(fold[1]), 2 * fold[0] * fold[1]
        folded = np.empty_like(upper)
        folded[0], folded[1], folded[2] = x, y * cos - z * sin, y * sin + z * cos
        reached = lanes.apply(shins, folded)
        reached += upper
        sizes = np.sqrt(asked * far)  # of both vectors, multiplied: what is reached has the length asked for
        along = lanes.dot(reached, way)
        along += sizes
        swing[0] = along
        swing[1:] = lanes.cross(reached, way)
        swing /= np.sqrt(np.maximum(2 * sizes * along, 1e-12))
