"""Halfway bones: helpers beside the 52 bones that keep the girth of bent shoulders and elbows.

Linear blend skinning draws a vertex that follows two bones straight from one place to the other, so a joint bent by
150 degrees loses most of its girth. A halfway bone stands at such a joint, hangs on the bone's parent and turns by half
of the bone's angle; vertices are blended from the parent to it, and from it to the bone, by half the angle each time.
"""

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix

HALFWAY = tuple(side + bone for bone in ("UpperArm", "LowerArm") for side in ("left", "right"))
SOURCES = tuple(HUMANOID.index(name) for name in HALFWAY)
PARENTS = tuple(HUMANOID.parents[joint] for joint in SOURCES)
BONES = (*HUMANOID.names, *(f"{name}Halfway" for name in HALFWAY))  # what `Character.joints` index
REST = np.concatenate([HUMANOID.rest_positions, HUMANOID.rest_positions[list(SOURCES)]])


def half(quaternions: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 4"]:
    """Half of each rotation the short way, as unit quaternions `wxyz` of any sign."""
    turned = np.where(quaternions[..., :1] < 0, -quaternions, quaternions)
    turned = turned + np.array([1, 0, 0, 0], turned.dtype)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def with_halfway(
    rotations: Float[np.ndarray, "j 3 3"], positions: Float[np.ndarray, "j 3"]
) -> tuple[Float[np.ndarray, "b 3 3"], Float[np.ndarray, "b 3"]]:
    """World rotations and positions of all `BONES`, from those of the joints of `HUMANOID`."""
    above, own = (rotations[list(joints)] for joints in (PARENTS, SOURCES))
    turned = above @ matrix_from_quaternion(half(quaternion_from_matrix(above.mT @ own)))
    return np.concatenate([rotations, turned]), np.concatenate([positions, positions[list(SOURCES)]])
