"""Contact sheets: a motion as rows of small pictures, to judge at a glance what numbers do not show; and files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from PIL import Image

from echoavatar.errors import EchoAvatarError
from echoavatar.files.avatar.video import Shot, film
from echoavatar.motion.kinematics import Motion


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
    """A grid of pictures, one in `every` frames (None spreads them over the whole motion), row by row.

    `face` holds blendshape weights beside the motion; `is_close` shows the face alone.
    """
    count = columns * rows
    step = every or max(1, motion.frames // count)
    at = np.minimum(np.arange(count) * step, motion.frames - 1)
    picked = Motion(motion.skeleton, motion.rotations[at], motion.root[at], motion.fps / step)  # the camera keeps up
    curves = None if face is None else face[at]
    pictures = np.stack(list(film(picked, face=curves, shot=Shot(size, "face" if is_close else "front"))))
    width, height = size
    grid = pictures.reshape(rows, columns, height, width, 3)
    return grid.transpose(0, 2, 1, 3, 4).reshape(rows * height, columns * width, 3)


def save_picture(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a PNG or JPEG, chosen by the suffix."""
    Image.fromarray(picture).save(path)


def save_figure(figure: Figure, path: Path, *, dpi: int = 110) -> None:
    """Write a plot: .png, .pdf or .svg.

    Raises:
        EchoAvatarError: it cannot be written.
    """
    try:
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise EchoAvatarError(f"cannot write {path} ({error}); name a .png in a folder that exists") from error
