"""The inner loop of the hand guard: how far each hand must go, where to, and the arm that follows (`guard` says why).

Compiled, eight frames of a session at once (`nn.octet`). Of all parts and hands only those are worked out in which some
point of the hand could be near; a frame without need keeps its rotations bit for bit.
"""

from typing import NamedTuple

import numpy as np

from ..kinematics.octets import (
    added,
    composed,
    dot,
    place_at,
    plus,
    quaternion,
    quaternion_at,
    rotation_at,
    seen_from,
    times,
    turned,
)
from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import exact, fused, inner, is_any, least, load, most, root, scratch, spread, store, where
from .arm import reach

SHELL = F(0.035)  # metres before contact at which a hand begins to give way
PALM = 1  # of a hand's points, the middle of its palm
_TWO, _QUARTER, _STEEP, _LEAST = F(2), F(0.25), F(1e9), F(1e-12)
_PER_SHELL = F(1 / float(SHELL))


class Tables(NamedTuple):
    """Body, hands and arms of a rig; the left hand and arm come first. Slots are places in the chains."""

    carriers: np.ndarray  # (e,) slots of the bones that carry the parts
    centres: np.ndarray  # (e, 3) metres, in the bone's frame
    radii: np.ndarray  # (e, 3) metres, with the thinnest point of the hand and its clearance around them
    shrinking: np.ndarray  # (e, 3) one over the radii
    zone: (
        np.ndarray
    )  # (e, 3) squared radii over those of an ellipsoid outside which no palm need be looked at
    starts: (
        np.ndarray
    )  # (2, e, 2) where the way out of each part starts for each hand: aside and ahead of its centre
    is_head: np.ndarray  # (e,) 1 for parts around which the way out also leads upwards
    points: np.ndarray  # (2, p) slots that carry the points of each hand
    offsets: np.ndarray  # (2, p, 3) metres, in the carrier's frame
    thicker: np.ndarray  # (p,) metres of thickness more than the thinnest point's
    arms: np.ndarray  # (2, 3) slots of upper arm, forearm, hand
    above: np.ndarray  # (2, 3) slots of what carries each of them
    joints: np.ndarray  # (2, 3) their joints in the rig


@exact()
def keep_off(tables, frames, turns):  # type: ignore[no-untyped-def]
    """Correct arms in `turns` (b, j, 4, 8) whose pose is `frames` (b, c, 12, 8)."""
    parts, points = tables.carriers.shape[0], tables.points.shape[1]
    balls, seen, places = scratch((parts, 12, 8)), scratch((parts, 3, 8)), scratch((points, 3, 8))
    for row in range(turns.shape[0]):
        for part in range(parts):
            for k, number in enumerate(_ball(tables, part, frames, row)):
                store(balls, (part, k), number)
        for side in range(2):
            is_near, way = _way(tables, side, frames, row, balls, seen)
            if not is_near:
                continue
            for point in range(points):
                for axis, number in enumerate(_point(tables, side, point, frames, row)):
                    store(places, (point, axis), number)
            reached = spread(ZERO, way[0])
            for part in range(parts):
                reached += _eighth(tables, part, balls, seen, places, way)
            far = SHELL * root(root(root(reached)))  # the most of them, without a corner where two are equal
            if is_any(far > ZERO):
                _follow(tables, side, frames, row, times(way, far), far > ZERO, turns)


@inner()
def _point(tables, side, point, frames, row):  # type: ignore[no-untyped-def]
    """Where a point of a hand is."""
    slot, offsets = tables.points[side, point], tables.offsets
    offset = offsets[side, point, 0], offsets[side, point, 1], offsets[side, point, 2]
    return plus(turned(rotation_at(frames, row, slot), offset), place_at(frames, row, slot))


@inner()
def _ball(tables, part, frames, row):  # type: ignore[no-untyped-def]
    """What makes a part the unit ball: a matrix for places, row by row, and after it what is to be added."""
    slot, shares, centres = tables.carriers[part], tables.shrinking, tables.centres
    turn, origin = rotation_at(frames, row, slot), place_at(frames, row, slot)
    x = times((turn[0], turn[3], turn[6]), shares[part, 0])
    y = times((turn[1], turn[4], turn[7]), shares[part, 1])
    z = times((turn[2], turn[5], turn[8]), shares[part, 2])
    at_x = -(dot(x, origin) + centres[part, 0] * shares[part, 0])
    at_y = -(dot(y, origin) + centres[part, 1] * shares[part, 1])
    at_z = -(dot(z, origin) + centres[part, 2] * shares[part, 2])
    return x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2], at_x, at_y, at_z


@inner()
def _ball_at(balls, part):  # type: ignore[no-untyped-def]
    """The matrix and what is to be added, as `_ball` made them."""
    return (
        (load(balls, (part, 0)), load(balls, (part, 1)), load(balls, (part, 2))),
        (load(balls, (part, 3)), load(balls, (part, 4)), load(balls, (part, 5))),
        (load(balls, (part, 6)), load(balls, (part, 7)), load(balls, (part, 8))),
        (load(balls, (part, 9)), load(balls, (part, 10)), load(balls, (part, 11))),
    )


@inner()
def _seen(ball, place):  # type: ignore[no-untyped-def]
    """A place as the part sees it: inside the unit ball is inside the part."""
    x, y, z, at = ball
    return added(at[0], x, place), added(at[1], y, place), added(at[2], z, place)


@inner()
def _is_near(tables, part, squares):  # type: ignore[no-untyped-def]
    """Whether any point of a hand could be near a part, from the squares of where the part sees the palm."""
    zone = tables.zone
    return squares[0] * zone[part, 0] + squares[1] * zone[part, 1] + squares[2] * zone[part, 2] < ONE


@inner()
def _way(tables, side, frames, row, balls, seen):  # type: ignore[no-untyped-def]
    """Whether a hand is near any part, and the unit direction in which it leaves the body.

    That is away from the nearest parts' starting points. `seen` becomes where each part sees the palm.
    """
    palm = _point(tables, side, PALM, frames, row)
    is_near = False
    zero = spread(ZERO, palm[0])
    total = (zero, zero, zero)
    for part in range(seen.shape[0]):
        here = _seen(_ball_at(balls, part), palm)
        for axis, number in enumerate(here):
            store(seen, (part, axis), number)
        squares = (here[0] * here[0], here[1] * here[1], here[2] * here[2])
        is_near |= is_any(_is_near(tables, part, squares))
        weight = ONE / (squares[0] + squares[1] + squares[2] + _QUARTER)
        weight = weight * weight * weight  # sharp enough that the nearest part alone decides the way out
        radii, starts = tables.radii, tables.starts
        up = most(here[1] * radii[part, 1], ZERO) * tables.is_head[part]
        x = here[0] * radii[part, 0] - starts[side, part, 0]
        z = here[2] * radii[part, 2] - starts[side, part, 1]
        turn = rotation_at(frames, row, tables.carriers[part])
        total = plus(total, turned(turn, times((x, up, z), weight)))
    return is_near, times(total, ONE / most(root(dot(total, total)), _LEAST))


@inner()
def _eighth(tables, part, balls, seen, places, way):  # type: ignore[no-untyped-def]
    """Sum over a hand's points of the eighth power of how far each must go to leave a part, in shells."""
    x, y, z = load(seen, (part, 0)), load(seen, (part, 1)), load(seen, (part, 2))
    is_near = _is_near(tables, part, (x * x, y * y, z * z))
    total = spread(ZERO, x)
    if not is_any(is_near):
        return total
    ball = _ball_at(balls, part)
    ahead = dot(ball[0], way), dot(ball[1], way), dot(ball[2], way)
    metres = ONE / root(dot(ahead, ahead))  # that lead one radius of the ball further
    ahead, shells = times(ahead, metres), metres * _PER_SHELL
    for point in range(places.shape[0]):
        here = _seen(ball, (load(places, (point, 0)), load(places, (point, 1)), load(places, (point, 2))))
        along = dot(ahead, here)
        square = fused(along, along, ONE - dot(here, here))
        way_out = fused(root(most(square, ZERO)) - along, shells, tables.thicker[point] * _PER_SHELL)
        way_out = least(way_out, fused(square, _STEEP, -ONE))  # a way that misses the part needs no exit
        share = least(most(way_out + ONE, ZERO), _TWO)
        short = fused(share * share, _QUARTER, most(way_out - ONE, ZERO))
        short = short * short
        short = short * short
        total = fused(short, short, total)
    return where(is_near, total, ZERO)


@inner()
def _follow(tables, side, frames, row, move, is_moved, turns):  # type: ignore[no-untyped-def]
    """New rotations of upper arm, forearm and hand, in the frames whose hand is moved; it keeps its direction."""
    arms, above = tables.arms, tables.above
    shoulder, elbow = place_at(frames, row, arms[side, 0]), place_at(frames, row, arms[side, 1])
    wrist, hand = place_at(frames, row, arms[side, 2]), rotation_at(frames, row, arms[side, 2])
    swing, bend = reach(shoulder, elbow, wrist, plus(wrist, move))
    upper = composed(swing, rotation_at(frames, row, arms[side, 0]))
    forearm = composed(
        bend, rotation_at(frames, row, arms[side, 1])
    )  # before the swing, as is what carries it then
    carrier = composed(swing, composed(bend, rotation_at(frames, row, above[side, 2])))
    new_upper = quaternion(seen_from(rotation_at(frames, row, above[side, 0]), upper))
    new_forearm = quaternion(seen_from(rotation_at(frames, row, above[side, 1]), forearm))
    new_hand = quaternion(seen_from(carrier, hand))
    for bone, new in enumerate((new_upper, new_forearm, new_hand)):
        joint = tables.joints[side, bone]
        old = quaternion_at(turns, row, joint)
        for k in range(4):
            store(turns, (row, joint, k), where(is_moved, new[k], old[k]))
