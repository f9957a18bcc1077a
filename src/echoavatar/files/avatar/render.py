"""Render the character without a display, by a small rasteriser of our own.

Off-screen OpenGL needs system libraries that bare machines lack; these loops need only numba. The picture has a
perspective camera, a key light with soft shadows, light from sky and ground, a rim light, a floor with a one-metre
grid, a filmic tone curve, and 2 x 2 supersampling.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import NDArray

from . import raster
from .character import MATERIALS, Character
from .textures import NAMES, Texels, decoded

_BYTES = np.arange(256) / 255
_LINEAR = np.where(_BYTES <= 0.04045, _BYTES / 12.92, ((_BYTES + 0.055) / 1.055) ** 2.4).astype(np.float32)
SHADOW_TEXELS = 1024
SHADOW_METRES = 3.6
LIGHT = np.array([0.45, 0.8, 0.55], np.float32) / np.float32(np.linalg.norm([0.45, 0.8, 0.55]))


@dataclass(frozen=True)
class Camera:
    """The camera's place and aim in metres, and its vertical field of view in radians."""

    position: tuple[float, float, float] = (0.0, 1.25, 4.1)
    target: tuple[float, float, float] = (0.0, 0.92, 0.0)
    field_of_view: float = 0.52

    def axes(self) -> Float[np.ndarray, "3 3"]:
        """The camera's axes as rows: right, up, backward."""
        back = np.array(self.position) - np.array(self.target)
        back = back / np.linalg.norm(back)
        right = np.cross([0.0, 1.0, 0.0], back)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Paint:
    """What stays the same from frame to frame: colours, triangles, pictures, and highlights (strength, exponent)."""

    colours: Float[np.ndarray, "v 3"]  # linear factors on the pictures
    triangles: Int[np.ndarray, "f 3"]
    uvs: Float[np.ndarray, "v 2"]
    pictures: Int[np.ndarray, " f"]  # -1: none
    cutouts: Bool[np.ndarray, " f"]  # seen from both sides, and only where the picture is opaque
    glosses: Float[np.ndarray, "f 2"]
    texels: Texels

    @classmethod
    def of(cls, character: Character) -> "Paint":
        """The paint of a character; its pictures are decoded here."""
        material = character.materials[character.triangles[:, 0]]
        return cls(
            colours=_LINEAR[character.colours],
            triangles=np.ascontiguousarray(character.triangles, np.int32),
            uvs=np.ascontiguousarray(character.uvs, np.float32),
            pictures=np.array([NAMES.index(m.picture) if m.picture else -1 for m in MATERIALS], np.int32)[material],
            cutouts=np.array([m.is_cutout for m in MATERIALS])[material],
            glosses=np.array([_gloss(m.roughness) for m in MATERIALS], np.float32)[material],
            texels=decoded(character.textures),
        )


def _gloss(roughness: float) -> tuple[float, float]:
    """Strength and exponent of a highlight."""
    return 0.9 * (1 - roughness) ** 2.5, min(600.0, 2 / roughness**4)


@dataclass(frozen=True)
class Surface:
    """One frame to draw: world positions and normals, and what is painted on them."""

    points: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    paint: Paint


class Renderer:
    """Draws surfaces at one picture size, and keeps its buffers between frames."""

    def __init__(self, width: int = 1280, height: int = 720, *, camera: Camera | None = None, samples: int = 2) -> None:
        """`samples` is the supersampling per axis; 1 is fast but jagged."""
        self.width, self.height, self.samples = width, height, samples
        self.camera = camera or Camera()
        wide, high = width * samples, height * samples
        self._depth = np.zeros((high, wide), np.float32)
        self._ids = np.zeros((high, wide), np.int32)
        self._image = np.zeros((height, width, 3), np.uint8)
        self._shadow = np.zeros((SHADOW_TEXELS, SHADOW_TEXELS), np.float32)
        self._tone = _tone_curve()

    def draw(self, surface: Surface) -> UInt8[np.ndarray, "h w 3"]:
        """The picture in sRGB."""
        points = np.ascontiguousarray(surface.points, np.float32)
        paint = surface.paint
        triangles, texels = paint.triangles, paint.texels
        screen, rays = self._project(points)
        to_light = _light_space(points)
        light = (points @ to_light[:, :3].T + to_light[:, 3]).astype(np.float32)
        raster.shadow_depth(light, triangles, self._shadow)
        raster.visible(screen, triangles, self._depth, self._ids, paint.uvs, paint.pictures, paint.cutouts, *texels)
        raster.shade(
            screen,
            points,
            np.ascontiguousarray(surface.normals, np.float32),
            paint.colours,
            triangles,
            self._ids,
            self._depth,
            self.samples,
            np.array(self.camera.position, np.float32),
            rays,
            to_light,
            self._shadow,
            _LOOK,
            self._tone,
            self._image,
            paint.uvs,
            paint.pictures,
            paint.glosses,
            texels.values,
            texels.table,
            _LINEAR,
        )
        return self._image.copy()

    def _project(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Screen x, y and 1/depth of the points, and the affine map from pixels to ray directions."""
        high, wide = self._depth.shape
        axes = self.camera.axes()
        focal = 0.5 * high / np.tan(self.camera.field_of_view / 2)
        seen = (points - np.array(self.camera.position)) @ axes.T
        near = 1.0 / np.maximum(-seen[:, 2], 1e-3)
        near[seen[:, 2] > -0.05] = 0
        screen = np.stack([wide / 2 + focal * seen[:, 0] * near, high / 2 - focal * seen[:, 1] * near, near], 1)
        right, up, back = axes
        corner = -back - right * (wide / 2) / focal + up * (high / 2) / focal
        return screen.astype(np.float32), np.stack([corner, right / focal, -up / focal]).astype(np.float32)


def _light_space(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """The (3, 4) map from world to shadow texels and height towards the light, centred on the surface."""
    side = np.cross([0.0, 1.0, 0.0], LIGHT)
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(LIGHT, side), LIGHT])
    middle = axes @ ((points.min(0) + points.max(0)) / 2)
    scale = np.array([SHADOW_TEXELS / SHADOW_METRES] * 2 + [1.0])
    shift = np.array([SHADOW_TEXELS / 2] * 2 + [0.0]) - scale * middle
    return np.concatenate([axes * scale[:, None], shift[:, None]], 1).astype(np.float32)


def _tone_curve() -> NDArray[np.uint8]:
    """A table from linear light, 0 to 4 in 4,096 steps, to sRGB bytes through a filmic shoulder."""
    x = np.arange(4096) / 1024
    filmic = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    srgb = np.where(filmic <= 0.0031308, 12.92 * filmic, 1.055 * np.maximum(filmic, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(np.clip(srgb, 0, 1) * 255).astype(np.uint8)


_LOOK = np.array(
    [
        LIGHT,
        [0.92, 0.87, 0.78],  # key light
        [0.36, 0.41, 0.50],  # from the sky
        [0.18, 0.16, 0.15],  # from the ground
        [0.24, 0.25, 0.27],  # floor
        [0.10, 0.115, 0.14],  # backdrop
    ],
    np.float32,
)
