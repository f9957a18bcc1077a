"""The compiled loops of limbs, in the root's frame: forward kinematics of a few joints, and two-bone IK of arm and leg.

The geometry is that of `kinematics.two_bone`, in closed form. An arm's elbow bends in its own plane, then the shoulder
swings. The hinge is the normal of the plane in which the arm already bends, so a rig need not name its elbow's axis,
and the bend has no kink at the stretched arm. A knee bends about its own hinge, the X axis of the lower leg, then the
whole leg swings by the least rotation; the foot keeps its world orientation.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.joint_tree import with_parents
from ..kinematics.quaternions import (
    IDENTITY,
    conjugate,
    cross,
    dot,
    from_rotation_vector,
    least_rotation,
    length,
    minus,
    multiply,
    normalized,
    plus,
    read_quaternion,
    read_vector,
    rotate,
    rotate_back,
    write_quaternion,
    write_vector,
)
from ..kinematics.two_bone import REACH

Array = np.ndarray


class ChainPose(NamedTuple):
    """Joints in the root's frame: the root is at the origin, without rotation."""

    rotations: Float[Array, "b t c 4"]
    places: Float[Array, "b t c 3"]  # metres


class Chains:
    """The wanted joints and all joints between them and the root."""

    def __init__(self, skeleton: Skeleton, wanted: list[int]) -> None:
        above = with_parents(wanted, skeleton.parents)
        self.joints = [0, *(joint for level in skeleton.levels for joint in level.joints if joint in above)]
        self.slot = {joint: slot for slot, joint in enumerate(self.joints)}
        self._joints = np.array(self.joints, np.int64)
        self._parents = np.array([self.slot.get(skeleton.parents[joint], 0) for joint in self.joints])
        self._offsets = np.ascontiguousarray(skeleton.offsets[self.joints], np.float32)

    def pose(self, rotations: Float[Array, "b t j 4"]) -> ChainPose:
        """The pose of the joints from parent-relative rotations."""
        shape = (*rotations.shape[:2], len(self.joints))
        pose = ChainPose(np.empty((*shape, 4), np.float32), np.empty((*shape, 3), np.float32))
        descend(rotations, self._joints, self._parents, self._offsets, pose)
        return pose


@kernel()
def descend(rotations, joints, parents, offsets, pose):  # type: ignore[no-untyped-def]
    """Fill `pose`; the root comes first, and every joint after its parent."""
    for row in range(rotations.shape[0]):
        for frame in range(rotations.shape[1]):
            world, places = pose.rotations[row, frame], pose.places[row, frame]
            write_quaternion(world[0], IDENTITY)
            write_vector(places[0], (0.0, 0.0, 0.0))
            for slot in range(1, len(joints)):
                above = read_quaternion(world[parents[slot]])
                bone = rotate(above, read_vector(offsets[slot]))
                write_vector(places[slot], plus(read_vector(places[parents[slot]]), bone))
                own = read_quaternion(rotations[row, frame, joints[slot]])
                write_quaternion(world[slot], multiply(above, own))


STRAIGHT = 0.25  # radians: an elbow straighter than this is bent less than asked; a straight one is not bent
LEAST_DROP = 0.15  # metres: a hand out of reach is raised at most to this depth below the shoulder
_FOLDED = -0.985  # cosine of the greatest bend
_STRETCHED = math.cos(STRAIGHT)


@kernel()
def bend_cosine(cosine, wanted):  # type: ignore[no-untyped-def]
    """Cosine of the elbow's new angle, from that of its old angle and that of the one that fits the distance."""
    fall = 1.0 - cosine
    angle_square = fall * (2.0 + fall * (1 / 3 + fall * 4 / 45))  # a series, exact to 2e-8 while the share is below 1
    share = min(angle_square / STRAIGHT**2, 1.0)
    blended = cosine + share * (wanted - cosine)
    return min(max(blended, min(cosine, _FOLDED)), max(cosine, _STRETCHED))


@kernel()
def reach(shoulder, elbow, wrist, target):  # type: ignore[no-untyped-def]
    """Rotations that bring the wrist to `target`: (swing of the whole arm, bend of the forearm before the swing).

    The arm always points at the target, and meets its distance where the elbow allows. A low target beyond the almost
    stretched arm is raised until the arm reaches it. If it is still out of reach, or if a straight arm (which has no
    plane to bend in) would have to bend, the arm only points at it, as in the paper.
    """
    upper, lower, wanted = minus(elbow, shoulder), minus(wrist, elbow), minus(target, shoulder)
    squares, along = dot(upper, upper) + dot(lower, lower), dot(upper, lower)
    product = length(upper) * length(lower)
    farthest = squares + 2.0 * max(along, product * _STRETCHED)
    room = max(farthest - wanted[0] * wanted[0] - wanted[2] * wanted[2], LEAST_DROP**2)
    wanted = (wanted[0], max(wanted[1], -math.sqrt(room)), wanted[2])
    cosine = min(max(along / product, -1.0), 1.0)
    new = bend_cosine(cosine, (dot(wanted, wanted) - squares) / (2.0 * product))
    further = math.acos(new) - math.acos(cosine)
    hinge = cross(upper, lower)
    sine = math.sin(further) / max(length(hinge), 1e-9)
    bend = normalized((1.0 + math.cos(further), hinge[0] * sine, hinge[1] * sine, hinge[2] * sine))
    return least_rotation(plus(upper, rotate(bend, lower)), wanted), bend


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
    offsets = skeleton.offsets
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
