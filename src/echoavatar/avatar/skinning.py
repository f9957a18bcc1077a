"""Linear blend skinning of the character for one frame."""

import numpy as np
from jaxtyping import Float

from .character import Character


def skin(
    character: Character,
    world_rotations: Float[np.ndarray, "j 3 3"],
    world_positions: Float[np.ndarray, "j 3"],
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """Vertices (metres) and unit normals in the pose given by the joints' world rotations and positions."""
    rotations = np.asarray(world_rotations, np.float32)
    shift = np.asarray(world_positions, np.float32) - np.einsum(
        "jik,jk->ji", rotations, character.rest_joints
    )
    moves = np.concatenate([rotations, shift[:, :, None]], 2).reshape(len(rotations), 12)
    blended = (character.dense_weights @ moves.astype(np.float32)).reshape(-1, 3, 4)
    vertices = np.einsum("vik,vk->vi", blended[:, :, :3], character.positions) + blended[:, :, 3]
    normals = np.einsum("vik,vk->vi", blended[:, :, :3], character.normals)
    normals /= np.maximum(np.sqrt(np.einsum("vi,vi->v", normals, normals)), 1e-9)[:, None]
    return vertices, normals
