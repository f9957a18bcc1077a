"""An arm of two bones brought to a target by bending the elbow in its own plane and swinging the shoulder.

Closed form, eight frames at once in compiled loops (`nn.octet`). The same geometry as `kinematics.two_bone`, but the
hinge is the normal of the plane in which the arm already bends, so no rig has to name its elbow's axis, and the bend is
taken in a form without corner at the stretched arm.
"""

import math

from ..kinematics.octets import cross, dot, minus, plus, times
from ..nn.compiled import ONE, ZERO, F
from ..nn.octet import inner, least, most, root

STRAIGHT = 0.25  # radians: an elbow straighter than this is bent less than asked, at 0 not at all
LEAST_DROP = 0.15  # metres below the shoulder to which a hand out of reach may be raised
_FOLDED = F(-0.985)  # cosine of the greatest bend
_STRETCHED = F(math.cos(STRAIGHT))
_STRAIGHT_SQUARE, _DROP_SQUARE = F(STRAIGHT**2), F(LEAST_DROP**2)
_TINY, _HALF_TURN = F(1e-9), F(1e-4)


@inner()
def reach(shoulder, elbow, wrist, target):  # type: ignore[no-untyped-def]
    """Matrices that bring the wrist to `target`: (swing of the whole arm, bend of the forearm before that).

    Always to its direction, and to its distance where the elbow allows. A low target beyond the almost stretched arm
    is raised until the arm reaches it. What is out of reach even then, or needs a straight arm (which has no plane to
    bend in) to bend, gets the direction alone, as in the paper.
    """
    upper, lower, wanted = minus(elbow, shoulder), minus(wrist, elbow), minus(target, shoulder)
    aa, bb, across_bones = dot(upper, upper), dot(lower, lower), dot(upper, lower)
    squares, ab = aa + bb, root(aa * bb)
    farthest = squares + F(2) * most(across_bones, ab * _STRETCHED)
    room = most(farthest - wanted[0] * wanted[0] - wanted[2] * wanted[2], _DROP_SQUARE)
    wanted = (wanted[0], most(wanted[1], -root(room)), wanted[2])
    far, by_upper, by_lower = dot(wanted, wanted), dot(upper, wanted), dot(lower, wanted)
    cosine = least(most(across_bones / ab, F(-1)), ONE)
    fall = ONE - cosine
    angle_square = fall * (
        F(2) + fall * (F(1 / 3) + fall * F(4 / 45))
    )  # to 2e-8 where the share is not yet 1
    share = least(angle_square * (ONE / _STRAIGHT_SQUARE), ONE)
    meant = cosine + share * ((far - squares) / (ab + ab) - cosine)
    new = least(most(meant, least(cosine, _FOLDED)), most(cosine, _STRETCHED))
    sine, new_sine = _sine(cosine), _sine(new)
    cos, sin = new * cosine + new_sine * sine, new_sine * cosine - new * sine  # of the further bend
    hinge = cross(upper, lower)
    turn = sin / most(root(dot(hinge, hinge)), _TINY)
    # the forearm bends to l' = of_upper u + of_lower l, so the arm reaches (1 + of_upper) u + of_lower l
    of_upper, of_lower = ONE - turn * bb, cos + turn * across_bones
    size = root((squares + F(2) * ab * new) * far)
    along = (of_upper * by_upper + of_lower * by_lower) / size
    by_both = plus(times(cross(upper, wanted), of_upper), times(cross(lower, wanted), of_lower))
    return turn_matrix(along, times(by_both, ONE / size)), turn_matrix(cos, times(hinge, turn))


@inner()
def turn_matrix(cosine, sine_axis):  # type: ignore[no-untyped-def]
    """The rotation with this cosine about this axis, whose length is the sine; smooth at no turn, not at a half."""
    x, y, z = sine_axis
    share = ONE / most(ONE + cosine, _HALF_TURN)
    xy, xz, yz = x * y * share, x * z * share, y * z * share
    return (
        cosine + x * x * share,
        xy - z,
        xz + y,
        xy + z,
        cosine + y * y * share,
        yz - x,
        xz - y,
        yz + x,
        cosine + z * z * share,
    )


@inner()
def _sine(cosine):  # type: ignore[no-untyped-def]
    """Of an angle between 0 and a half turn."""
    return root(most((ONE - cosine) * (ONE + cosine), ZERO))
