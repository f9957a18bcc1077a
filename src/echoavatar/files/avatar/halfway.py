"""Halfway bones: helpers beside the 52 bones that keep the flesh of bent shoulders and elbows.

Linear blend skinning draws a vertex that follows two bones straight from one place to the other, so a joint bent by
150 degrees loses most of its girth. A halfway bone stands at such a joint, hangs on the bone's parent and turns by half
of what the bone does; vertices go over from the parent to it and from it to the bone, by half the angle each time.
"""

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics import HUMANOID

HALFWAY = tuple(side + bone for bone in ("UpperArm", "LowerArm") for side in ("left", "right"))
SOURCES = tuple(HUMANOID.index(name) for name in HALFWAY)
PARENTS = tuple(HUMANOID.parents[joint] for joint in SOURCES)
BONES = (*HUMANOID.names, *(f"{name}Halfway" for name in HALFWAY))  # what `Character.joints` index
REST = np.concatenate([HUMANOID.rest_positions.numpy(), HUMANOID.rest_positions.numpy()[list(SOURCES)]])
_LEAST = 1e-4  # of a quaternion's real part: half of a turn by 180 degrees has no axis


def half(quaternions: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 4"]:
    """Half of each rotation the short way, as unit quaternions `wxyz` of any sign."""
    turned = np.where(quaternions[..., :1] < 0, -quaternions, quaternions)
    turned = turned + np.array([1, 0, 0, 0], turned.dtype)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def with_halfway(
    rotations: Float[np.ndarray, "j 3 3"], positions: Float[np.ndarray, "j 3"]
) -> tuple[Float[np.ndarray, "b 3 3"], Float[np.ndarray, "b 3"]]:
    """World rotations and positions of all `BONES`, from those of the joints of `HUMANOID`."""
    above, own = rotations[list(PARENTS)], rotations[list(SOURCES)]
    local = above.swapaxes(1, 2) @ own
    w = np.sqrt(np.maximum(1 + np.trace(local, axis1=1, axis2=2), 4 * _LEAST**2)) / 2
    skew = local - local.swapaxes(1, 2)
    axis = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], 1) / (4 * w[:, None])
    turned = above @ _matrix(half(np.concatenate([w[:, None], axis], 1)))
    return np.concatenate([rotations, turned]), np.concatenate([positions, positions[list(SOURCES)]])


def _matrix(quaternions: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 3 3"]:
    w, (x, y, z) = quaternions[:, 0], quaternions[:, 1:].T
    flat = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(flat, 1).reshape(-1, 3, 3)
