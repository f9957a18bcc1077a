"""A picture of the character's 52 face shapes: `python -m echoavatar_character.face_sheet [OUT]`."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.render import Renderer, Surface
from echoavatar.files.avatar.sheet import save_picture
from echoavatar.files.avatar.video import HEAD, close_up, linear

SHIPPED = Path(__file__).parents[4] / "docs" / "img" / "face_shapes.jpg"


def main() -> None:
    """Draw the character that is shipped, and save the picture."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED
    out.parent.mkdir(parents=True, exist_ok=True)
    save_picture(out, face_sheet())
    print(f"{out}: {out.stat().st_size} bytes")


def face_sheet(
    shapes: Sequence[str] | None = None, *, columns: int = 9, size: tuple[int, int] = (150, 170)
) -> UInt8[np.ndarray, "h w 3"]:
    """The face at rest, then each of `shapes` (None: all) alone; `mouthClose` with the jaw open that it closes."""
    character = load_character()
    near = close_up(character.rest_joints[HEAD])
    near = replace(near, target=(0.0, 1.562, 0.0), field_of_view=0.25)
    renderer = Renderer(*size, camera=near, samples=2)
    colours = linear(character.colours)
    names = character.face.names
    wanted = names if shapes is None else shapes
    weights = np.zeros((1 + len(wanted), len(names)), np.float32)
    for row, name in enumerate(wanted, 1):
        weights[row, names.index(name)] = 1
        weights[row, names.index("jawOpen")] = name in ("jawOpen", "mouthClose")
    pictures = [renderer.draw(Surface(*character.with_face(row), colours, character.triangles)) for row in weights]
    rows = -(-len(pictures) // columns)
    blank = [np.zeros_like(pictures[0])] * (rows * columns - len(pictures))
    width, height = size
    grid = np.stack(pictures + blank).reshape(rows, columns, height, width, 3)
    return grid.transpose(0, 2, 1, 3, 4).reshape(rows * height, columns * width, 3)


if __name__ == "__main__":
    main()
