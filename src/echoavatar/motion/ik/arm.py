"""An arm of two bones brought to a target by bending the elbow in its own plane and swinging the shoulder.

Closed form. The same geometry as `kinematics.two_bone`, but the hinge is the normal of the plane in which the arm
already bends, so no rig has to name its elbow's axis, and the bend is taken in a form without corner at the stretched
arm.
"""

import math

from echoavatar.nn.kernels import kernel

from ..kinematics.quaternions import (
    cross,
    dot,
    least_rotation,
    length,
    minus,
    normalized,
    plus,
    rotate,
)

STRAIGHT = 0.25  # radians: an elbow straighter than this is bent less than asked, at 0 not at all
LEAST_DROP = 0.15  # metres below the shoulder to which a hand out of reach may be raised
_FOLDED = -0.985  # cosine of the greatest bend
_STRETCHED = math.cos(STRAIGHT)


@kernel()
def bend_cosine(cosine, wanted):  # type: ignore[no-untyped-def]
    """Cosine of the elbow's new angle, from that of its old angle and that of the angle that meets the distance."""
    fall = 1.0 - cosine
    angle_square = fall * (2.0 + fall * (1 / 3 + fall * 4 / 45))  # to 2e-8 where the share is not yet 1
    share = min(angle_square / STRAIGHT**2, 1.0)
    meant = cosine + share * (wanted - cosine)
    return min(max(meant, min(cosine, _FOLDED)), max(cosine, _STRETCHED))


@kernel()
def reach(shoulder, elbow, wrist, target):  # type: ignore[no-untyped-def]
    """Rotations that bring the wrist to `target`: (swing of the whole arm, bend of the forearm before that).

    Always to its direction, and to its distance where the elbow allows. A low target beyond the almost stretched arm
    is raised until the arm reaches it. What is out of reach even then, or needs a straight arm (which has no plane to
    bend in) to bend, gets the direction alone, as in the paper.
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
