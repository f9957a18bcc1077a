"""Two-bone IK of a leg, in closed form; the foot keeps its world orientation.

The geometry is that of `kinematics.two_bone`, in the root's frame and compiled. The knee bends about its own hinge, the
X axis of the lower leg. Then the whole leg swings by the least rotation.
"""

import math
from typing import NamedTuple

import numpy as np

from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.quaternions import (
    conjugate,
    from_rotation_vector,
    least_rotation,
    length,
    minus,
    multiply,
    plus,
    read_quaternion,
    read_vector,
    rotate,
    rotate_back,
    write_quaternion,
)
from ..kinematics.two_bone import REACH
from .chains import Chains


class Legs(NamedTuple):
    """Both legs of a rig as arrays for compiled loops, left first."""

    joints: np.ndarray  # (2, 4) thigh, shin, foot, toes (the foot again, where there are no toes)
    slots: np.ndarray  # (2, 4) the same joints' indices into the chains
    above: np.ndarray  # (2,) slots of the thighs' parents
    ankles: np.ndarray  # (2, 3) in the shin's frame, metres
    bones: np.ndarray  # (2, 2) lengths of thigh and shin, metres


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
    chains = chains or Chains(skeleton, list(feet))
    joints = np.array([thighs, shins, ankles, toes], np.int64).T.copy()
    slots = np.array([[chains.slot[joint] for joint in leg] for leg in joints.tolist()], np.int64)
    above = np.array([chains.slot[skeleton.parents[joint]] for joint in thighs], np.int64)
    offsets = skeleton.offsets.numpy().astype(np.float32)
    bones = np.linalg.norm(offsets[joints[:, 1:3]], axis=2)
    return Legs(joints, slots, above, offsets[ankles], bones)


@kernel()
def knee_fold(legs, side, shin, upper, way):  # type: ignore[no-untyped-def]
    """The rotation of the shin, in its own frame, that puts the ankle at the length of `way` from the hip."""
    a, b = legs.bones[side, 0], legs.bones[side, 1]
    distance = min(max(length(way), abs(a - b) + 1e-4), REACH * (a + b))
    x, y, z = read_vector(legs.ankles[side])
    seen = rotate_back(shin, upper)
    # the knee's angle t solves cosine cos t + sine sin t = wanted
    cosine, sine = y * seen[1] + z * seen[2], y * seen[2] - z * seen[1]
    wanted = (distance * distance - a * a - b * b) / 2.0 - x * seen[0]
    share = wanted / max(math.hypot(cosine, sine), 1e-9)
    angle = math.atan2(sine, cosine) + math.acos(min(max(share, -1.0), 1.0))
    return from_rotation_vector((angle, 0.0, 0.0))


@kernel()
def bend(legs, side, rotations, world, places, aside):  # type: ignore[no-untyped-def]
    """Rotate thigh, shin and foot in one frame so that the ankle moves by `aside`, as far as the leg reaches.

    `rotations` (j, 4) is changed; `world` (c, 4) and `places` (c, 3) are the chains before; `aside` is in the root's
    frame.
    """
    slots, joints = legs.slots[side], legs.joints[side]
    hip, knee, ankle = (read_vector(places[slots[0]]), read_vector(places[slots[1]]), read_vector(places[slots[2]]))
    thigh, shin, foot = (
        read_quaternion(world[slots[0]]),
        read_quaternion(world[slots[1]]),
        read_quaternion(world[slots[2]]),
    )
    upper, way = minus(knee, hip), minus(plus(ankle, aside), hip)
    fold = knee_fold(legs, side, shin, upper, way)
    folded = multiply(shin, fold)
    reached = plus(upper, rotate(folded, read_vector(legs.ankles[side])))
    swing = least_rotation(reached, way)
    above, new_thigh = read_quaternion(world[legs.above[side]]), multiply(swing, thigh)
    write_quaternion(rotations[joints[0]], multiply(conjugate(above), new_thigh))
    write_quaternion(rotations[joints[1]], multiply(conjugate(thigh), folded))
    write_quaternion(rotations[joints[2]], multiply(conjugate(multiply(swing, folded)), foot))
