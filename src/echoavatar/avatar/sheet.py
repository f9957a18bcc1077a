"""Contact sheets: a motion as rows of small pictures, to judge at a glance what numbers do not tell."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ..errors import DependencyError
from ..kinematics import Motion
from .video import film


def contact_sheet(
    motion: Motion,
    *,
    columns: int = 10,
    rows: int = 4,
    every: int | None = None,
    size: tuple[int, int] = (180, 260),
    face: Float[np.ndarray, "t n"] | None = None,
    is_close: bool = False,
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures every `every` frames (spread over the whole motion when None), left to right, top to bottom.

    `face` holds blendshape weights beside the motion; `is_close` shows the face alone.
    """
    count = columns * rows
    step = every or max(1, motion.frames // count)
    at = np.minimum(np.arange(count) * step, motion.frames - 1)
    picked = Motion(motion.skeleton, motion.rotations[at], motion.root[at], motion.fps)
    curves = None if face is None else face[at]
    pictures = np.stack(list(film(picked, face=curves, size=size, samples=2, is_close=is_close)))
    width, height = size
    grid = pictures.reshape(rows, columns, height, width, 3)
    return grid.transpose(0, 2, 1, 3, 4).reshape(rows * height, columns * width, 3)


def save_picture(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a PNG or, by the suffix, a JPEG; raises DependencyError without pillow."""
    try:
        from PIL import Image
    except ImportError as error:
        raise DependencyError("pictures need pillow; run: pip install 'echoavatar[render]'") from error
    Image.fromarray(picture).save(path)
