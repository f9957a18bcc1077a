"""The compiled loop of the hand collisions: how far each hand must go, where to, and the arm that follows.

`hand_collisions` says why. Parts that no point of a hand could be near are passed over. A frame in which no hand has to
go keeps its rotations bit for bit.
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

SHELL = 0.035  # metres before contact at which a hand begins to give way
PALM = 1  # of a hand's points, the middle of its palm


class Tables(NamedTuple):
    """Body, hands and arms of a rig; the left hand and arm come first. Slots are places in the chains."""

    carriers: np.ndarray  # (e,) slots of the bones that carry the parts
    centres: np.ndarray  # (e, 3) metres, in the bone's frame
    radii: np.ndarray  # (e, 3) metres, with the thinnest point of the hand and its clearance around them
    zone: np.ndarray  # (e, 3) metres: radii of an ellipsoid; a hand whose palm is outside is not near
    starts: np.ndarray  # (2, e, 3) metres from a part's centre: where each hand's way out starts
    is_head: np.ndarray  # (e,) whether the way out also leads upwards
    points: np.ndarray  # (2, p) slots that carry the points of each hand
    offsets: np.ndarray  # (2, p, 3) metres, in the carrier's frame
    thicker: np.ndarray  # (p,) metres of thickness more than the thinnest point's
    arms: np.ndarray  # (2, 3) slots of upper arm, forearm, hand
    above: np.ndarray  # (2, 3) slots of what carries each of them
    joints: np.ndarray  # (2, 3) their joints in the rig


@kernel()
def point_of(tables, side, point, turned, places):  # type: ignore[no-untyped-def]
    """Where a point of a hand is."""
    slot, offset = tables.points[side, point], read_vector(tables.offsets[side, point])
    return plus(rotate(read_quaternion(turned[slot]), offset), read_vector(places[slot]))


@kernel()
def scaled(v, radii):  # type: ignore[no-untyped-def]
    """A vector in a part's axes, in units of the part's radii: inside the unit ball is inside the part."""
    return v[0] / radii[0], v[1] / radii[1], v[2] / radii[2]


@kernel()
def from_centre(tables, part, turned, places, point):  # type: ignore[no-untyped-def]
    """A point as seen from a part's centre, in the part's axes, metres."""
    slot = tables.carriers[part]
    seen = rotate_back(read_quaternion(turned[slot]), minus(point, read_vector(places[slot])))
    return minus(seen, read_vector(tables.centres[part]))


@kernel()
def is_near(tables, part, palm):  # type: ignore[no-untyped-def]
    """Whether any point of a hand whose palm is there, seen from the part's centre, could be near the part."""
    ball = scaled(palm, tables.zone[part])
    return dot(ball, ball) < 1.0


@kernel()
def way_out(tables, side, turned, palms):  # type: ignore[no-untyped-def]
    """The unit direction in which a hand leaves the body: away from the nearest parts' starting points."""
    total = (0.0, 0.0, 0.0)
    for part in range(len(palms)):
        palm, start = read_vector(palms[part]), read_vector(tables.starts[side, part])
        ball = scaled(palm, tables.radii[part])
        weight = 1.0 / (dot(ball, ball) + 0.25) ** 3  # sharp enough that the nearest part alone decides
        up = max(palm[1], 0.0) if tables.is_head[part] else 0.0
        away = (palm[0] - start[0], up, palm[2] - start[2])
        total = plus(total, rotate(read_quaternion(turned[tables.carriers[part]]), times(away, weight)))
    return times(total, 1.0 / max(length(total), 1e-12))


@kernel()
def shells_to_go(tables, part, point, ahead, per_radius, thicker):  # type: ignore[no-untyped-def]
    """How far a point must go to leave a part, smoothly from 0, in shells.

    `point` and the unit vector `ahead` are in the part's radii; `per_radius` is how many shells such a radius is long.
    """
    along = dot(ahead, point)
    square = along * along + 1.0 - dot(point, point)
    if square <= 0.0:  # a way that misses the part needs no exit
        return 0.0
    far = (math.sqrt(square) - along) * per_radius + thicker / SHELL
    share = min(max(far + 1.0, 0.0), 2.0)
    return share * share / 4.0 + max(far - 1.0, 0.0)


@kernel()
def metres_to_go(tables, side, turned, places, way, palms):  # type: ignore[no-untyped-def]
    """How far a hand must go: the most of what its points ask for, without a corner where two are equal."""
    total = 0.0
    for part in range(len(palms)):
        if not is_near(tables, part, read_vector(palms[part])):
            continue
        radii = tables.radii[part]
        ahead = scaled(rotate_back(read_quaternion(turned[tables.carriers[part]]), way), radii)
        radius = 1.0 / length(ahead)  # metres along the way
        ahead = times(ahead, radius)
        for point in range(tables.points.shape[1]):
            place = point_of(tables, side, point, turned, places)
            ball = scaled(from_centre(tables, part, turned, places, place), radii)
            total += shells_to_go(tables, part, ball, ahead, radius / SHELL, tables.thicker[point]) ** 8
    return SHELL * total ** (1 / 8)


@kernel()
def follow(tables, side, turned, places, move, rotations):  # type: ignore[no-untyped-def]
    """New rotations of upper arm, forearm and hand in one frame; the hand keeps its direction."""
    arms, above, joints = tables.arms[side], tables.above[side], tables.joints[side]
    shoulder, elbow, wrist = (
        read_vector(places[arms[0]]),
        read_vector(places[arms[1]]),
        read_vector(places[arms[2]]),
    )
    swing, bend = reach(shoulder, elbow, wrist, plus(wrist, move))
    upper = multiply(swing, read_quaternion(turned[arms[0]]))
    forearm = multiply(bend, read_quaternion(turned[arms[1]]))  # before the swing, like what carries it
    hand = read_quaternion(turned[arms[2]])
    carrier = multiply(swing, multiply(bend, read_quaternion(turned[above[2]])))
    write_quaternion(rotations[joints[0]], multiply(conjugate(read_quaternion(turned[above[0]])), upper))
    write_quaternion(rotations[joints[1]], multiply(conjugate(read_quaternion(turned[above[1]])), forearm))
    write_quaternion(rotations[joints[2]], multiply(conjugate(carrier), hand))


@kernel()
def keep_off(tables, chains, rotations):  # type: ignore[no-untyped-def]
    """Correct arms in `rotations` (b, t, j, 4) whose chains are those of the pose before."""
    parts = len(tables.carriers)
    palms = np.empty((parts, 3))
    for row in range(rotations.shape[0]):
        for frame in range(rotations.shape[1]):
            turned, places = chains.rotations[row, frame], chains.places[row, frame]
            for side in range(2):
                palm = point_of(tables, side, PALM, turned, places)
                near = False
                for part in range(parts):
                    seen = from_centre(tables, part, turned, places, palm)
                    write_vector(palms[part], seen)
                    near |= is_near(tables, part, seen)
                if not near:
                    continue
                way = way_out(tables, side, turned, palms)
                far = metres_to_go(tables, side, turned, places, way, palms)
                if far > 0.0:
                    follow(tables, side, turned, places, times(way, far), rotations[row, frame])
