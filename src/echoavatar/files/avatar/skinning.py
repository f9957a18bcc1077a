"""Linear blend skinning of the character for one frame, in one compiled pass over the vertices."""

import numpy as np
from jaxtyping import Float

from echoavatar.motion.kinematics import HUMANOID
from echoavatar.nn.kernels import kernel

from .character import Character
from .halfway import REST, with_halfway

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
    rotations, places = np.asarray(world_rotations, np.float32), np.asarray(world_positions, np.float32)
    rest = character.skeleton.rest_positions
    if character.skeleton is HUMANOID:
        (rotations, places), rest = with_halfway(rotations, places), REST
    shift = places - np.einsum("jik,jk->ji", rotations, rest)
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
