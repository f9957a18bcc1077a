"""The surroundings of the character: backdrop, light and the film's tone curve."""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from echoavatar.errors import MotionError

TONE = (2.51, 0.03, 2.43, 0.59, 0.14)  # a filmic shoulder: x (a x + b) / (x (c x + d) + e), a fit of ACES by Narkowicz
HELP = "studio (default), dusk, plain, or a colour such as #00ff00"


@dataclass(frozen=True)
class Backdrop:
    """Light and backdrop.

    Attributes:
        look: (6, 3): direction to the key light, its colour, light from the sky, from the ground, direction to the
            light from behind, its colour.
        top, horizon, bottom: sRGB colours of the backdrop, 0 to 255, from the picture's top to its bottom.
        shadow: strength of the key light's shadow on the floor, and of the contact shadow.
    """

    look: Float[np.ndarray, "6 3"]
    top: tuple[int, int, int]
    horizon: tuple[int, int, int]
    bottom: tuple[int, int, int]
    shadow: tuple[float, float]

    @classmethod
    def of(cls, background: str) -> "Backdrop":
        """The backdrop of this name, or one colour: `#rrggbb`.

        Raises MotionError: there is no such backdrop.
        """
        if background in BACKDROPS:
            return BACKDROPS[background]
        if not re.fullmatch("#[0-9a-fA-F]{6}", background):
            raise MotionError(f"there is no background {background!r}; choose {HELP}")
        red, green, blue = bytes.fromhex(background[1:])
        flat = (red, green, blue)
        return cls(_DAY, flat, flat, flat, BACKDROPS["plain"].shadow)

    def picture(self, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
        """A soft wall that turns into the floor without an edge, with the light in its middle."""
        y = np.linspace(0, 1, height)[:, None, None]
        x = np.linspace(-1, 1, width)[None, :, None]
        top, horizon, bottom = (np.array(colour, float) for colour in (self.top, self.horizon, self.bottom))
        wall, floor = np.clip(y / 0.62, 0, 1), np.clip((y - 0.62) / 0.38, 0, 1)
        wall, floor = wall * wall * (3 - 2 * wall), floor * floor * (3 - 2 * floor)
        colour = top + (horizon - top) * wall + (bottom - horizon) * floor
        colour = colour * (1 - 0.10 * (self.top != self.bottom) * x**2)
        noise = np.random.default_rng(0).uniform(0, 1, (height, width, 1))  # without it a slow gradient shows bands
        is_flat = self.top == self.horizon == self.bottom
        return np.asarray(np.clip(colour + (0.0 if is_flat else noise), 0, 255), np.uint8)


def tone_curve() -> UInt8[np.ndarray, " 4096"]:
    """A table from linear light, 0 to 4 in 4,096 steps, to sRGB bytes through a filmic shoulder."""
    x = np.arange(4096) / 1024
    a, b, c, d, e = TONE
    filmic = x * (a * x + b) / (x * (c * x + d) + e)
    srgb = np.where(filmic <= 0.0031308, 12.92 * filmic, 1.055 * np.maximum(filmic, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(np.clip(srgb, 0, 1) * 255).astype(np.uint8)


def _look(*rows: tuple[float, float, float]) -> Float[np.ndarray, "6 3"]:
    look = np.array(rows, np.float32)
    for row in (0, 4):
        look[row] /= np.linalg.norm(look[row])
    return look


_DAY = _look(
    (1.6, 3.4, 2.6), (0.80, 0.745, 0.68), (0.40, 0.42, 0.46), (0.20, 0.18, 0.165),
    (-2.2, 2.6, -2.4), (0.30, 0.34, 0.40),
)  # fmt: skip
_EVENING = _look(
    (1.6, 2.4, 2.6), (0.86, 0.68, 0.50), (0.24, 0.26, 0.40), (0.15, 0.11, 0.12),
    (-2.2, 2.0, -2.4), (0.42, 0.40, 0.72),
)  # fmt: skip
BACKDROPS: dict[str, Backdrop] = {
    "studio": Backdrop(_DAY, (222, 226, 231), (238, 240, 242), (214, 216, 219), (0.30, 0.45)),
    "dusk": Backdrop(_EVENING, (28, 30, 48), (74, 62, 82), (44, 38, 50), (0.45, 0.55)),
    "plain": Backdrop(_DAY, (255, 255, 255), (255, 255, 255), (255, 255, 255), (0.22, 0.40)),
}
