"""The pictures on a character: encoded in its file, decoded with their reductions (mip levels) for the rasteriser."""

import io
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

NAMES = ("atlas", "hair", "knit", "twill")  # colours, which the rasteriser draws too
# In glTF; films read the roughness of skin alone.
DETAILS = ("knit_normal", "twill_normal", "skin_roughness", "knit_roughness", "twill_roughness")


@dataclass(frozen=True)
class Textures:
    """Encoded pictures, JPEG or PNG, or nothing for a detail that is left out.

    `hair` has alpha. `knit` and `twill` are grey and repeat, as their normal and roughness maps do; that of skin lies
    on the atlas.
    """

    atlas: bytes
    hair: bytes
    knit: bytes
    twill: bytes
    knit_normal: bytes = b""
    twill_normal: bytes = b""
    skin_roughness: bytes = b""
    knit_roughness: bytes = b""
    twill_roughness: bytes = b""

    @property
    def present(self) -> list[str]:
        """The names of the pictures that there are."""
        return [name for name in NAMES + DETAILS if getattr(self, name)]

    def plain(self) -> "Textures":
        """Colours alone."""
        return replace(self, **dict.fromkeys(DETAILS, b""))

    def arrays(self) -> dict[str, Any]:
        """As arrays of bytes for an npz."""
        return {f"texture_{field.name}": np.frombuffer(getattr(self, field.name), np.uint8) for field in fields(self)}

    @classmethod
    def of_arrays(cls, stored: dict[str, np.ndarray]) -> "Textures":
        """What `arrays` made."""
        return cls(*(stored[f"texture_{name}"].tobytes() for name in NAMES + DETAILS))


class Texels(NamedTuple):
    """All decoded pictures in one list, RGBA in sRGB; `table` (picture, level) holds start, width, height."""

    values: UInt8[np.ndarray, "n 4"]
    table: Int[np.ndarray, "p l 3"]


LEVELS = 6


def decoded(textures: Textures) -> Texels:
    """Decode the pictures and reduce each by halves."""
    from PIL import Image

    lists, table, start = [], np.zeros((len(NAMES), LEVELS, 3), np.int64), 0
    for row, name in enumerate(NAMES):
        level = np.asarray(Image.open(io.BytesIO(getattr(textures, name))).convert("RGBA"))
        for column in range(LEVELS):
            height, width = level.shape[:2]
            table[row, column] = start, width, height
            lists.append(level.reshape(-1, 4))
            start += width * height
            level = _halved(level)
    return Texels(np.ascontiguousarray(np.concatenate(lists)), table)


def _halved(level: UInt8[np.ndarray, "h w 4"]) -> UInt8[np.ndarray, "i j 4"]:
    """Half as wide and high. Alpha counts as weight, and is raised so that cut-out strands do not thin out."""
    height, width = level.shape[0] // 2 * 2, level.shape[1] // 2 * 2
    if min(height, width) < 2:
        return level
    values = level[:height, :width].astype(np.float32)
    alpha = values[..., 3:]
    total = _sum_of_fours(alpha)
    shown = _sum_of_fours(values[..., :3] * alpha) / np.maximum(total, 1)
    colour = np.where(total > 0, shown, _sum_of_fours(values[..., :3]) / 4)
    return np.concatenate([colour, np.minimum(total / 4 * 1.12, 255)], 2).astype(np.uint8)


def _sum_of_fours(values: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "i j c"]:
    """The sum of each square of four."""
    rows = values[::2] + values[1::2]
    return np.asarray(rows[:, ::2] + rows[:, 1::2])


def looked_up(
    texels: Texels, picture: Int[np.ndarray, " v"], uvs: Float[np.ndarray, "v 2"]
) -> Float[np.ndarray, "v 3"]:
    """The sRGB colour (0 to 1) of a picture at each place, from the third level; -1 is white."""
    out = np.ones((len(uvs), 3), np.float32)
    for row in range(len(NAMES)):
        start, width, height = texels.table[row, 2]
        here = picture == row
        x = (uvs[here, 0] % 1 * width).astype(int).clip(0, width - 1)
        y = (uvs[here, 1] % 1 * height).astype(int).clip(0, height - 1)
        out[here] = texels.values[start + y * width + x, :3] / np.float32(255)
    return out


def grey_at(encoded: bytes, uvs: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, " v"]:
    """The value (0 to 1) of a grey picture that does not repeat, at each place."""
    from PIL import Image

    picture = np.asarray(Image.open(io.BytesIO(encoded)).convert("L"))
    size = np.array(picture.shape[::-1])
    x, y = (uvs * size).astype(int).clip(0, size - 1).T
    return np.asarray(picture[y, x] / np.float32(255))
