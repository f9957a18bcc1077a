"""Face MSE and LVD: errors of the face's vertices, as EMAGE's table has them (Liu et al., CVPR 2024, arXiv 2401.00374).

- MSE: mean of the squared difference of vertices, over frames, vertices and axes, m^2 (after CodeTalker, 2023);
- LVD: mean of the absolute difference of the vertices' steps from frame to frame, m a frame (after TalkSHOW, 2023).
  EMAGE's tools divide the sum by the number of frames, not of steps; so does this.

EMAGE prints MSE times 1e8 and LVD times 1e5. Its vertices are those of FLAME. Ours are those of the shipped character
that ARKit's curves move, so only values of one mesh compare.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from echoavatar.files.avatar.character import load_character
from echoavatar.motion.arkit import ARKIT_NAMES


def face_mse(made: Float[np.ndarray, "t c"], true: Float[np.ndarray, "t c"]) -> float:
    """Mean squared difference of vertices (flattened)."""
    return float(np.square(np.asarray(made, float) - true).mean())


def face_lvd(made: Float[np.ndarray, "t c"], true: Float[np.ndarray, "t c"]) -> float:
    """Summed absolute difference of steps, over frames and values."""
    return float(np.abs(np.diff(np.asarray(made, float) - true, axis=0)).sum() / made.size)


def errors_on_mesh(made: Float[np.ndarray, "t 52"], true: Float[np.ndarray, "t 52"]) -> tuple[float, float]:
    """MSE (m^2) and LVD (m) of two sets of ARKit curves on the character's face."""
    ours, theirs = (np.asarray(curves, float) @ _shapes() for curves in (made, true))
    return face_mse(ours, theirs), face_lvd(ours, theirs)


@lru_cache(maxsize=1)
def _shapes() -> Float[np.ndarray, "52 c"]:
    """How far each curve at 1 moves each axis of each vertex that any curve moves, metres."""
    face = load_character().face
    used = np.unique(face.vertices)
    found = np.zeros((len(ARKIT_NAMES), len(used), 3))
    for name, at, moves, _ in face.on(used):
        if name in ARKIT_NAMES:
            found[ARKIT_NAMES.index(name), at] = moves
    return found.reshape(len(ARKIT_NAMES), -1)
