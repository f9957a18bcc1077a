"""Contact sheets: a motion as rows of small pictures, to judge at a glance what numbers do not show."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from echoavatar.files.avatar.video import Shot, film
from echoavatar.motion.kinematics import Motion
from echoavatar.whole_file import whole_file


def contact_sheet(
    motion: Motion, *, columns: int = 10, rows: int = 4, every: int | None = None, size: tuple[int, int] = (180, 260)
) -> UInt8[np.ndarray, "h w 3"]:
    """A grid of pictures, one in `every` frames (None spreads them over the whole motion), row by row."""
    count = columns * rows
    step = every or max(1, motion.frames // count)
    at = np.minimum(np.arange(count) * step, motion.frames - 1)
    root = motion.root[at].copy()
    root[:, [0, 2]] = 0  # who walks stays in the middle
    picked = Motion(motion.skeleton, motion.rotations[at], root, motion.fps / step)
    pictures = np.stack(list(film(picked, shot=Shot(size))))
    width, height = size
    grid = pictures.reshape(rows, columns, height, width, 3)
    return grid.transpose(0, 2, 1, 3, 4).reshape(rows * height, columns * width, 3)


def save_picture(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a PNG or JPEG, chosen by the suffix. Raises EchoAvatarError if it cannot be written."""
    with whole_file(path, failures=(ValueError, KeyError)) as partial:
        Image.fromarray(picture).save(partial, Image.registered_extensions()[path.suffix.lower()])
