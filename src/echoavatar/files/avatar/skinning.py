"""Linear blend skinning of the character for one frame, with halfway bones at shoulders and elbows.

Linear blend skinning draws a vertex that follows two bones straight from one place to the other, so a joint bent by
150 degrees loses most of its girth. A halfway bone stands at such a joint, hangs on the bone's parent and turns by half
of what the bone does; vertices go over from the parent to it and from it to the bone, by half the angle each time.
"""

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.nn.kernels import kernel

from .character import Character

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


F = np.float32


def skin(
    character: Character,
    world_rotations: Float[np.ndarray, "j 3 3"],
    world_positions: Float[np.ndarray, "j 3"],
    face: Float[np.ndarray, " n"] | None = None,
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """Vertices (metres) and unit normals in the pose of the given world rotations and positions of the joints.

    `face` holds the weights of the character's blendshapes; None is the neutral face.
    """
    positions, normals = (character.positions, character.normals) if face is None else character.with_face(face)
    rotations, places = with_halfway(np.asarray(world_rotations, np.float32), np.asarray(world_positions, np.float32))
    shift = places - np.einsum("jik,jk->ji", rotations, character.rest_joints)
    moves = np.concatenate([rotations, shift[:, :, None]], 2).astype(np.float32)
    vertices, turned = np.empty_like(positions), np.empty_like(normals)
    blended(positions, normals, character.joints, character.weights, moves, vertices, turned)
    return vertices, turned


@kernel(fastmath=True)
def blended(positions, normals, joints, weights, moves, vertices, turned):  # type: ignore[no-untyped-def]
    """Fill `vertices` and unit normals `turned` (v, 3): each by the weighted `moves` (j, 3, 4) of its four joints."""
    for v in range(positions.shape[0]):
        length = F(1e-18)
        for i in range(3):
            x, y, z, w = F(0.0), F(0.0), F(0.0), F(0.0)
            for k in range(joints.shape[1]):
                share, move = weights[v, k], moves[joints[v, k], i]
                x += share * move[0]
                y += share * move[1]
                z += share * move[2]
                w += share * move[3]
            vertices[v, i] = x * positions[v, 0] + y * positions[v, 1] + z * positions[v, 2] + w
            turned[v, i] = x * normals[v, 0] + y * normals[v, 1] + z * normals[v, 2]
            length += turned[v, i] * turned[v, i]
        scale = F(1.0) / np.sqrt(length)
        for i in range(3):
            turned[v, i] *= scale
