"""Two faults of motion, measured: planted feet that slide, and hands inside the body."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from echoavatar.errors import MotionError
from echoavatar.motion.ik import BodyProfile, body_of_rig
from echoavatar.motion.ik.hand_collisions import Body, hand_points
from echoavatar.motion.kinematics import Skeleton, forward_kinematics
from echoavatar.motion.kinematics.foot_planting import sliding
from echoavatar.motion.kinematics.rigs import bone_map

DIGITS = ("Thumb", "Index", "Middle", "Ring", "Little")
FINGER_JOINTS = [f"{digit}{part}" for digit in DIGITS for part in ("Proximal", "Intermediate", "Distal")]


def skate(
    positions: NDArray[np.floating], fps: float, *, standing_height: NDArray[np.floating] | float | None = None
) -> float:
    """Mean horizontal speed of planted feet (`foot_planting.sliding`), centimetres per second."""
    return 100 * sliding(positions, fps, standing_height=standing_height)


def penetration_depth_m(
    skeleton: Skeleton, rotations: Float[np.ndarray, "t j 3 3"], profile: BodyProfile | None = None
) -> Float[np.ndarray, "t 2"]:
    """Depth of the deepest point of the left and the right hand below the skin of torso, neck or head, metres.

    The points are all joints and tips of all fingers, each with its thickness. The distance to an ellipsoid is exact at
    the skin and of first order below it. 0 where the hand is outside. Raises MotionError if the rig's bones are not
    known, or a rotation is not finite.
    """
    if not np.isfinite(rotations).all():
        raise MotionError("the motion holds rotations that are not finite; leave out these frames")
    bones, profile = bone_map(skeleton), profile or body_of_rig(skeleton)
    body = Body(skeleton, profile)
    world, places = forward_kinematics(skeleton, rotations, np.zeros((len(rotations), 3), np.float32))
    depths = []
    for side in ("left", "right"):
        hand = hand_points(skeleton, bones, side, FINGER_JOINTS)
        joints, offsets = ([point.joint for point in hand], np.array([point.offset for point in hand], np.float32))
        points = np.einsum("tpij,pj->tpi", world[:, joints], offsets) + places[:, joints]
        thick = np.array([profile.palm if point.is_palm else profile.finger for point in hand], np.float32)
        away = points[:, None] - places[:, body.joints, None]
        seen = np.einsum("teij,tepi->tepj", world[:, body.joints], away) - body.centres[:, None]
        seen = seen / body.radii[:, None]  # in each part's own axes, in which the part is the unit ball
        far = np.sqrt((seen**2).sum(-1))
        steep = np.sqrt(((seen / body.radii[:, None]) ** 2).sum(-1))
        below = far * (1 - far) / np.maximum(steep, 1e-6) + thick
        depths.append(np.maximum(below.max((1, 2)), 0))
    return np.stack(depths, -1)
