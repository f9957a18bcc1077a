"""Linear blend skinning of the character for one frame."""

import numpy as np
from jaxtyping import Float

from .character import Character


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
    rotations = np.asarray(world_rotations, np.float32)
    shift = np.asarray(world_positions, np.float32) - np.einsum("jik,jk->ji", rotations, character.rest_joints)
    moves = np.concatenate([rotations, shift[:, :, None]], 2).reshape(len(rotations), 12)
    blended = (character.dense_weights @ moves.astype(np.float32)).reshape(-1, 3, 4)
    vertices = np.einsum("vik,vk->vi", blended[:, :, :3], positions) + blended[:, :, 3]
    turned = np.einsum("vik,vk->vi", blended[:, :, :3], normals)
    turned /= np.maximum(np.sqrt(np.einsum("vi,vi->v", turned, turned)), 1e-9)[:, None]
    return vertices, turned
