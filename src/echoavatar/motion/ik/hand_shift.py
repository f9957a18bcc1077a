"""The compiled loop of `hand_collisions`: where and how far each hand must move, and the arm that follows.

Parts that a hand cannot be near are skipped. A frame in which no hand must move keeps its rotations bit for bit.
"""

import math
from typing import NamedTuple

import numpy as np

from echoavatar.nn.kernels import kernel

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
from .arm import reach

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
