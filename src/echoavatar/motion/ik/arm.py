"""Two-bone IK of an arm, in closed form: the elbow bends in its own plane, then the shoulder swings.

The geometry is that of `kinematics.two_bone`, with two differences. The hinge is the normal of the plane in which the
arm already bends, so a rig need not name its elbow's axis. The bend has no kink at the stretched arm.
"""

import math

from echoavatar.nn.kernels import kernel

from ..kinematics.quaternions import cross, dot, least_rotation, length, minus, normalized, plus, rotate

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
