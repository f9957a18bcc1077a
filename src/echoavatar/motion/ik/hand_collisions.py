"""Hands kept out of torso, neck and head (paper, Online Post-Processing), for many sessions at once.

As in the paper there is no detection and no optimisation. A smooth map of space moves points inside the body to its
surface, along the local horizontal, and leaves points outside a thin shell where they are. The arm follows its hand.
The map sees one frame at a time: it has no state, so it cannot drift, and the chunking does not matter.

Departures from the paper:

- The body is a stack of ellipsoids that bend with spine and head, instead of a cylinder in the pelvis' axes.
- The way out starts at a line near the back and the far side, where no hand passes, instead of at the axis. A hand that
  sweeps through the axis therefore slides along the front. Around the head the way out also leads upwards.
- All points of a hand move the same way, as far as the deepest of them needs. One step frees wrist, palm and fingers.
- The elbow bends too, so that the hand meets the target's distance and not only its direction.
- The hand keeps its orientation in the world, and there is no smallest correction.

A hand is a set of points: wrist, middle of the palm, knuckles and fingertips. The compiled loop `keep_off` skips parts
that a hand cannot be near. A frame in which no hand must move keeps its rotations bit for bit.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.nn.kernels import kernel

from ..kinematics import Skeleton
from ..kinematics.joint_tree import SIDES
from ..kinematics.quaternions import (
    conjugate,
    dot,
    length,
    minus,
    multiply,
    plus,
    read_quaternion,
    read_vector,
    rotate,
    rotate_back,
    times,
    write_quaternion,
    write_vector,
)
from ..kinematics.rigs import bone_map
from ..kinematics.skeleton import other_side
from .limbs import Array, ChainPose, Chains, reach
from .profile import BodyProfile, RoundedPart, body_of_rig

KNUCKLES = ("ThumbProximal", "IndexProximal", "LittleProximal", "IndexIntermediate", "LittleIntermediate")
TIPS = ("ThumbDistal", "IndexDistal", "MiddleDistal", "RingDistal", "LittleDistal")
PALM_PLACE = 0.5  # of the way from wrist to knuckles
FINGERLESS = (0.35, 0.70)  # palm and fingertips of a rig without fingers, in forearm lengths beyond the wrist


class HandPoint(NamedTuple):
    """A point of a hand: its joint, its offset in the joint's frame (metres), and whether it is palm or finger."""

    joint: int
    offset: Float[np.ndarray, " 3"]
    is_palm: bool


def hand_points(
    skeleton: Skeleton, bones: dict[str, int], side: str, joints: Sequence[str] = KNUCKLES
) -> list[HandPoint]:
    """Points of one hand: wrist, middle of the palm, these finger joints, tips; without fingers, along the hand."""
    rest = skeleton.rest_positions
    wrist = bones[f"{side}Hand"]
    forearm = rest[wrist] - rest[bones[f"{side}LowerArm"]]
    knuckle = next((bones[name] for d in ("Middle", "Index") if (name := f"{side}{d}Proximal") in bones), None)
    along = FINGERLESS[0] * forearm if knuckle is None else PALM_PLACE * (rest[knuckle] - rest[wrist])
    points = [HandPoint(wrist, np.zeros(3), True), HandPoint(wrist, along, True)]
    if knuckle is None:
        points.append(HandPoint(wrist, FINGERLESS[1] * forearm, False))
    for name in joints:
        if (joint := bones.get(f"{side}{name}")) is not None:
            points.append(HandPoint(joint, np.zeros(3), name in ("IndexProximal", "LittleProximal")))
    for name in TIPS:
        if (joint := bones.get(f"{side}{name}")) is not None:
            tip = skeleton.config.tips.get(skeleton.names[joint])
            end = 0.8 * (rest[joint] - rest[skeleton.parents[joint]]) if tip is None else np.array(tip)
            points.append(HandPoint(joint, end, False))
    return points


class Body:
    """The parts of a profile whose bones the rig has."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile) -> None:
        bones = bone_map(skeleton)
        self.parts: list[RoundedPart] = [part for part in profile.parts if part.bone in bones]
        self.joints = [bones[part.bone] for part in self.parts]
        self.centres = np.array([part.centre for part in self.parts], np.float32)  # (e, 3), in the bone's frame
        self.radii = np.array([part.radii for part in self.parts], np.float32)


SHELL = 0.035  # metres before contact at which a hand begins to move
PALM = 1  # index of the middle of the palm among a hand's points


class Tables(NamedTuple):
    """Body, hands and arms of a rig, left before right. Slots are indices into the chains."""

    carriers: np.ndarray  # (e,) slots of the bones that carry the parts
    centres: np.ndarray  # (e, 3) metres, in the bone's frame
    radii: np.ndarray  # (e, 3) metres, enlarged by the hand's thinnest point and the clearance
    zone: np.ndarray  # (e, 3) metres: radii of the ellipsoid outside of which a palm's hand is not near the part
    starts: np.ndarray  # (2, e, 3) metres from a part's centre: where each hand's way out starts
    is_head: np.ndarray  # (e,) whether the way out also leads upwards
    points: np.ndarray  # (2, p) slots that carry the points of each hand
    offsets: np.ndarray  # (2, p, 3) metres, in the carrier's frame
    thicker: np.ndarray  # (p,) metres by which a point is thicker than the thinnest one
    arms: np.ndarray  # (2, 3) slots of upper arm, forearm, hand
    above: np.ndarray  # (2, 3) slots of their parents
    joints: np.ndarray  # (2, 3) joints of the rig


@kernel()
def point_of(tables, side, point, world, places):  # type: ignore[no-untyped-def]
    """Position of a point of a hand."""
    slot, offset = tables.points[side, point], read_vector(tables.offsets[side, point])
    return plus(rotate(read_quaternion(world[slot]), offset), read_vector(places[slot]))


@kernel()
def scaled(v, radii):  # type: ignore[no-untyped-def]
    """A vector in a part's axes, in units of its radii: the part is the unit ball."""
    return v[0] / radii[0], v[1] / radii[1], v[2] / radii[2]


@kernel()
def from_centre(tables, part, world, places, point):  # type: ignore[no-untyped-def]
    """A point relative to a part's centre, in the part's axes, metres."""
    slot = tables.carriers[part]
    seen = rotate_back(read_quaternion(world[slot]), minus(point, read_vector(places[slot])))
    return minus(seen, read_vector(tables.centres[part]))


@kernel()
def is_near(tables, part, palm):  # type: ignore[no-untyped-def]
    """Whether a hand may be near the part; `palm` is the position of its palm as by `from_centre`."""
    ball = scaled(palm, tables.zone[part])
    return dot(ball, ball) < 1.0


@kernel()
def way_out(tables, side, world, palms):  # type: ignore[no-untyped-def]
    """The unit direction in which a hand leaves the body: away from the nearest parts' starting points."""
    total = (0.0, 0.0, 0.0)
    for part in range(len(palms)):
        palm, start = read_vector(palms[part]), read_vector(tables.starts[side, part])
        ball = scaled(palm, tables.radii[part])
        weight = 1.0 / (dot(ball, ball) + 0.25) ** 3  # so sharp that the nearest part decides alone
        up = max(palm[1], 0.0) if tables.is_head[part] else 0.0
        away = (palm[0] - start[0], up, palm[2] - start[2])
        total = plus(total, rotate(read_quaternion(world[tables.carriers[part]]), times(away, weight)))
    return times(total, 1.0 / max(length(total), 1e-12))


@kernel()
def shells_to_go(tables, part, point, ahead, per_radius, thicker):  # type: ignore[no-untyped-def]
    """How far a point must move to leave a part, in shells; rises smoothly from 0.

    `point` and the unit vector `ahead` are in the part's radii; `per_radius` is the number of shells per radius.
    """
    along = dot(ahead, point)
    square = along * along + 1.0 - dot(point, point)
    if square <= 0.0:  # the way misses the part
        return 0.0
    far = (math.sqrt(square) - along) * per_radius + thicker / SHELL
    share = min(max(far + 1.0, 0.0), 2.0)
    return share * share / 4.0 + max(far - 1.0, 0.0)


@kernel()
def metres_to_go(tables, side, world, places, way, palms):  # type: ignore[no-untyped-def]
    """How far a hand must move: a smooth maximum (8-norm) over its points and the parts."""
    total = 0.0
    for part in range(len(palms)):
        if not is_near(tables, part, read_vector(palms[part])):
            continue
        radii = tables.radii[part]
        ahead = scaled(rotate_back(read_quaternion(world[tables.carriers[part]]), way), radii)
        radius = 1.0 / length(ahead)  # metres along the way
        ahead = times(ahead, radius)
        for point in range(tables.points.shape[1]):
            place = point_of(tables, side, point, world, places)
            ball = scaled(from_centre(tables, part, world, places, place), radii)
            total += shells_to_go(tables, part, ball, ahead, radius / SHELL, tables.thicker[point]) ** 8
    return SHELL * total ** (1 / 8)


@kernel()
def follow(tables, side, world, places, move, rotations):  # type: ignore[no-untyped-def]
    """Write the rotations of upper arm, forearm and hand in one frame; the hand keeps its world orientation."""
    arms, above, joints = tables.arms[side], tables.above[side], tables.joints[side]
    shoulder, elbow, wrist = (read_vector(places[arms[0]]), read_vector(places[arms[1]]), read_vector(places[arms[2]]))
    swing, bend = reach(shoulder, elbow, wrist, plus(wrist, move))
    upper = multiply(swing, read_quaternion(world[arms[0]]))
    forearm = multiply(bend, read_quaternion(world[arms[1]]))  # before the swing, like its parent
    hand = read_quaternion(world[arms[2]])
    parent = multiply(swing, multiply(bend, read_quaternion(world[above[2]])))
    write_quaternion(rotations[joints[0]], multiply(conjugate(read_quaternion(world[above[0]])), upper))
    write_quaternion(rotations[joints[1]], multiply(conjugate(read_quaternion(world[above[1]])), forearm))
    write_quaternion(rotations[joints[2]], multiply(conjugate(parent), hand))


@kernel()
def keep_off(tables, chains, rotations):  # type: ignore[no-untyped-def]
    """Correct the arms in `rotations` (b, t, j, 4); `chains` is the pose before the correction."""
    parts = len(tables.carriers)
    palms = np.empty((parts, 3))
    for row in range(rotations.shape[0]):
        for frame in range(rotations.shape[1]):
            world, places = chains.rotations[row, frame], chains.places[row, frame]
            for side in range(2):
                palm = point_of(tables, side, PALM, world, places)
                near = False
                for part in range(parts):
                    seen = from_centre(tables, part, world, places, palm)
                    write_vector(palms[part], seen)
                    near |= is_near(tables, part, seen)
                if not near:
                    continue
                way = way_out(tables, side, world, palms)
                far = metres_to_go(tables, side, world, places, way, palms)
                if far > 0.0:
                    follow(tables, side, world, places, times(way, far), rotations[row, frame])


CLEARANCE = 0.006  # metres of air between hand and body
BEHIND, ACROSS = 0.70, 0.30  # where the way out starts, in half depths and half widths of a part


class HandCollisions:
    """Moves arms so that no hand is inside the body. The motion of a rig whose arms are not known passes unchanged."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile | None = None) -> None:
        """Without `profile`: `body_of_rig`. `chains` has hips and feet, too, so that stages can share its pose."""
        self.is_able, ends = _has_arms(skeleton), [0, *skeleton.config.feet]
        if not self.is_able:
            self.chains = Chains(skeleton, ends)
            return
        self.profile = profile or body_of_rig(skeleton)
        bones, body = bone_map(skeleton), Body(skeleton, self.profile)
        self._hands = _common_points(skeleton, bones)
        carriers = [[point.joint for point in hand] for hand in self._hands]
        self.chains = Chains(skeleton, [*ends, *body.joints, *carriers[0], *carriers[1]])
        own = [self.profile.palm if point.is_palm else self.profile.finger for point in self._hands[0]]
        thicker = np.array(own, np.float32) - np.float32(min(own))
        radii = body.radii + np.float32(min(own) + CLEARANCE)
        arms = [[bones[f"{side}{bone}"] for bone in ("UpperArm", "LowerArm", "Hand")] for side in SIDES]

        def slots(joints: list[list[int]]) -> Array:
            return np.array([[self.chains.slot[joint] for joint in row] for row in joints], np.int64)

        self._tables = Tables(
            carriers=slots([body.joints])[0],
            centres=body.centres,
            radii=radii,
            zone=_zone(radii, _span(skeleton, self._hands[0]) + SHELL + float(thicker.max())),
            starts=_starts(body),
            is_head=np.array([part.bone == "head" for part in body.parts]),
            points=slots(carriers),
            offsets=np.array([[point.offset for point in hand] for hand in self._hands], np.float32),
            thicker=thicker,
            arms=slots(arms),
            above=slots([[skeleton.parents[joint] for joint in arm] for arm in arms]),
            joints=np.array(arms, np.int64),
        )

    def resolve(self, rotations: Float[Array, "b t j 4"], chains: ChainPose | None = None) -> None:
        """Correct upper arms, forearms and hands in place where a hand is inside; `chains` is the pose's, if known."""
        if self.is_able:
            keep_off(self._tables, chains or self.chains.pose(rotations), rotations)


def _has_arms(skeleton: Skeleton) -> bool:
    try:
        bones = bone_map(skeleton)
    except MotionError:
        return False
    needed = [f"{side}{bone}" for side in SIDES for bone in ("UpperArm", "LowerArm", "Hand")]
    return all(bone in bones for bone in (*needed, "hips", "head"))


def _common_points(skeleton: Skeleton, bones: dict[str, int]) -> list[list[HandPoint]]:
    """Points of both hands, in the same order; fingers that either hand lacks are left out."""
    both = {name: joint for name, joint in bones.items() if other_side(name) in bones}
    return [hand_points(skeleton, both, side) for side in SIDES]


def _starts(body: Body) -> Float[Array, "2 e 3"]:
    """Where the way out of each part starts, from the part's centre: on the right for the left hand, and vice versa."""
    starts = np.zeros((2, len(body.parts), 3), np.float32)
    starts[:, :, 0] = ACROSS * body.radii[:, 0] * np.array([[-1.0], [1.0]])
    starts[:, :, 2] = -BEHIND * body.radii[:, 2]
    return starts


def _span(skeleton: Skeleton, hand: list[HandPoint]) -> float:
    """The greatest distance between the middle of the palm and a point of the hand, for any bend of fingers; metres."""
    wrist, palm = hand[0].joint, hand[1].offset
    far = 0.0
    for point in hand:
        length, joint = float(np.linalg.norm(point.offset)), point.joint
        while joint != wrist and skeleton.parents[joint] != wrist:
            length += float(np.linalg.norm(skeleton.offsets[joint]))
            joint = skeleton.parents[joint]
        base = np.zeros(3) if joint == wrist else skeleton.offsets[joint]
        far = max(far, length + float(np.linalg.norm(base - palm)))
    return far


def _zone(radii: Float[Array, "e 3"], distance: float) -> Float[Array, "e 3"]:
    """Radii of ellipsoids that contain every point within `distance` of the ellipsoids of `radii`."""
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((4000, 3)).astype(np.float32)
    squares = np.square(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    needed = np.sqrt(squares @ np.square(radii).T) + distance
    wide = radii + np.float32(distance)
    held = np.sqrt(squares @ np.square(wide).T)
    zone: Array = wide * (1.002 * (needed / held).max(0))[:, None]
    return zone
