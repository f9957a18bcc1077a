"""Render the character without a display, by a small rasteriser of our own.

Off-screen OpenGL needs system libraries that bare machines lack; these loops need only numba. The picture has a
perspective camera, a key light with soft shadows, light from sky and ground and from behind, a contact shadow on the
floor, a filmic tone curve, and 2 x 2 supersampling. The compiled loops release the interpreter's lock, so several
renderers draw at once in threads.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Integer, UInt8
from numpy.typing import NDArray

from . import raster, shading
from .backdrop import Backdrop, tone_curve
from .character import Character, Texels, grey_at

_BYTES = np.arange(256) / 255
_LINEAR = np.where(_BYTES <= 0.04045, _BYTES / 12.92, ((_BYTES + 0.055) / 1.055) ** 2.4).astype(np.float32)
SHADOW_TEXELS = 512
SHADOW_METRES = 2.6
CONTACT_CELLS = 128
CONTACT_METRES = 1.92
SPREAD_METRES = np.float32(0.25)  # from the body to the end of its shadows' soft edges
MATT = 0.7  # roughness above which skin is painted hair
Box = tuple[int, int, int, int]  # pixels: left, top, and right, bottom, which are not included
NEAR_M = 1.5  # to the target: a closer camera sees shadows in finer texels


@dataclass(frozen=True)
class Camera:
    """The camera's place and aim in metres, and its vertical field of view in radians."""

    position: tuple[float, float, float] = (0.0, 1.25, 4.1)
    target: tuple[float, float, float] = (0.0, 0.92, 0.0)
    field_of_view: float = 0.52

    @cached_property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """The camera's axes as rows: right, up, backward."""
        back = np.array(self.position) - np.array(self.target)
        back = back / np.linalg.norm(back)
        right = np.cross([0.0, 1.0, 0.0], back)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Paint:
    """Data that all frames share: colours, triangles, pictures, and highlights (strength, exponent)."""

    colours: Float[np.ndarray, "v 3"]  # linear factors on the pictures
    triangles: Integer[np.ndarray, "f 3"]  # unsigned: see `raster.U`
    uvs: Float[np.ndarray, "v 2"]
    pictures: Int[np.ndarray, " f"]  # -1: none
    two_sided: Bool[np.ndarray, " f"]
    cutouts: Int[np.ndarray, " f"]  # the picture whose clear places are cut out; -1: none
    sheer: Bool[np.ndarray, " f"]  # whether a cutout shows through where it is less than opaque
    glosses: Float[np.ndarray, "f 2"]
    texels: Texels

    @cached_property
    def spreads(self) -> Float[np.ndarray, " f"]:
        """Twice the texels of its picture that lie on each triangle."""
        sides = np.diff(self.uvs[self.triangles], axis=1)
        texels = np.append(self.texels.table[:, 0, 1:].prod(1), 0)[self.pictures]
        return np.asarray(np.abs(np.linalg.det(sides)) * texels, np.float32)

    @classmethod
    def of(cls, character: Character) -> "Paint":
        """The paint of a character; its pictures are decoded here."""
        material, palette = character.materials[character.triangles[:, 0]], character.palette
        texels, pictures = character.texels
        cuts = np.array([m.is_cutout or m.is_sheer for m in palette])
        return cls(
            colours=_LINEAR[character.colours],
            triangles=np.ascontiguousarray(character.triangles, np.uint32),
            uvs=np.ascontiguousarray(character.uvs, np.float32),
            pictures=pictures[material],
            two_sided=np.array([m.is_two_sided for m in palette])[material],
            cutouts=np.where(cuts, pictures, -1)[material],
            sheer=np.array([m.is_sheer for m in palette])[material],
            glosses=_glosses(character, material),
            texels=texels,
        )


def _glosses(character: Character, material: Integer[np.ndarray, " f"]) -> Float[np.ndarray, "f 2"]:
    """Each triangle's highlight is its material's; hair painted on skin (by the roughness map) has none."""
    glosses: Float[np.ndarray, "f 2"] = np.array([_gloss(m.roughness) for m in character.palette], np.float32)[material]
    if roughness := character.textures.get("skin_roughness"):
        skin = [m.name for m in character.palette].index("skin")
        places = character.uvs[character.triangles].mean(1)
        glosses[(material == skin) & (grey_at(roughness, places) > MATT)] = _gloss(1.0)
    return glosses


def _gloss(roughness: float) -> tuple[float, float]:
    """Strength and exponent of a highlight."""
    return 0.9 * (1 - roughness) ** 2.5, min(600.0, 2 / roughness**4)


@dataclass(frozen=True)
class Surface:
    """One frame to draw: world positions and normals, and the paint on them."""

    points: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    paint: Paint


class Renderer:
    """Draws surfaces at one size on one backdrop, and keeps its buffers between frames; for one thread at a time.

    Attributes:
        empty: (h, w, c): the picture of nothing.
        drawn: the boxes outside which the last picture is `empty`.
    """

    def __init__(
        self,
        width: int = 1280,
        height: int = 720,
        *,
        camera: Camera | None = None,
        samples: int = 2,
        background: str = "studio",
        alpha: bool = False,
    ) -> None:
        """`samples` is the supersampling per axis; 1 is fast but jagged. `alpha` leaves the backdrop clear.

        Raises MotionError: there is no such background.
        """
        self.width, self.height, self.samples = width, height, samples
        self._grid = height * samples, width * samples
        self.camera = camera or Camera()
        self._backdrop = Backdrop.of(background)
        self.empty = self._backdrop.picture(width, height)
        if alpha:
            self.empty = np.zeros((height, width, 4), np.uint8)
        self.drawn: tuple[Box, ...] = ((0, 0, width, height),)
        self._contact = np.zeros((CONTACT_CELLS, CONTACT_CELLS), np.float32)
        self._strength = np.array(self._backdrop.shadow, np.float32)
        self._tone = tone_curve()
        self._bounds = np.zeros((3, 2, 3), np.float32)
        self._allocate()

    def _allocate(self) -> None:
        """Buffers of the body and of its shadow."""
        self._depth = np.zeros(self._grid, np.float32)
        self._ids = np.zeros(self._grid, np.int32)
        self._shadow = np.zeros((SHADOW_TEXELS, SHADOW_TEXELS), np.float32)
        self._screen = np.zeros((0, 3), np.float32)
        self._light = self._screen

    def draw(self, surface: Surface) -> UInt8[np.ndarray, "h w c"]:
        """The picture in sRGB, and its alpha as a fourth channel if the backdrop is clear."""
        points = np.ascontiguousarray(surface.points, np.float32)
        normals = np.ascontiguousarray(surface.normals, np.float32)
        paint, texels, look = surface.paint, surface.paint.texels, self._backdrop.look
        if len(self._screen) != len(points):
            self._screen, self._light = (np.zeros((len(points), 3), np.float32) for _ in range(2))
        place = np.array(self.camera.position, np.float32)
        rays = self._rays()
        self._project(points, self._screen)
        raster.bounds(points, look[0], self._bounds)
        to_light = self._light_space(look[0])
        raster.shadow_depth(points, paint.triangles, paint.two_sided, to_light, self._light, self._shadow)
        image = self.empty.copy()
        floor = self._draw_shadow(image, points, place, rays, to_light)
        box = self._box(self._screen)
        self.drawn = floor, self._pixels(box)
        buffers = self._depth, self._ids, box
        raster.visible(
            self._screen, paint.triangles, *buffers, paint.uvs, paint.two_sided, paint.cutouts, paint.sheer, *texels
        )
        shading.shade(
            self._screen, points, normals, paint.colours, paint.uvs, paint.triangles, self._ids, self._depth, box,
            self.samples, place, to_light, self._shadow, look, self._tone, image, paint.pictures, paint.spreads,
            paint.glosses, paint.sheer, texels.values, texels.table, _LINEAR,
        )  # fmt: skip
        return image

    def _draw_shadow(
        self,
        image: NDArray[np.uint8],
        points: NDArray[np.float32],
        place: NDArray[np.float32],
        rays: NDArray[np.float32],
        to_light: NDArray[np.float32],
    ) -> Box:
        """Darken the floor where the body's shadow falls; returns the box around the pixels that may have changed."""
        middle, contact_map = self._touch(points)
        low, high = self._bounds[2, 0] - SPREAD_METRES, self._bounds[2, 1] + SPREAD_METRES
        corners = np.array([[x, 0, z] for x in (low[0], high[0]) for z in (low[2], high[2])], np.float32)
        seen = np.zeros_like(corners)
        self._project(corners, seen)
        is_anywhere = bool((seen[:, 2] <= 0).any())  # a corner is behind the camera
        box = (0, 0, self.width, self.height) if is_anywhere else self._pixels(self._box(seen))
        margin = SPREAD_METRES * np.linalg.norm(to_light[0, :3])
        reach = self._light[:, 0].min() - margin, self._light[:, 0].max() + margin
        left, right = shading.floor_shadow(
            image, box, self.samples, place, rays, middle, to_light, reach, self._shadow, self._contact, contact_map,
            self._strength,
        )  # fmt: skip
        return left, box[1], right, box[3]

    def _touch(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Fill the contact shadow; returns the body's middle on the floor, and the map from metres to cells."""
        middle = self._bounds[0, :, ::2].mean(0)
        scale = CONTACT_CELLS / CONTACT_METRES
        contact_map = np.array([[scale, CONTACT_CELLS / 2 - scale * at] for at in middle], np.float32)
        shading.nearness(points, self._contact, contact_map)
        shading.softened(self._contact)
        return middle, contact_map

    @property
    def _focal(self) -> float:
        return float(0.5 * self._grid[0] / np.tan(self.camera.field_of_view / 2))

    def _project(self, points: NDArray[np.float32], screen: NDArray[np.float32]) -> None:
        high, wide = self._grid
        axes = self.camera.axes.astype(np.float32)
        place = np.array(self.camera.position, np.float32)
        raster.projected(points, place, axes, np.float32(self._focal), np.float32(wide), np.float32(high), screen)

    def _box(self, screen: NDArray[np.float32]) -> Box:
        """The samples around the points, in whole pixels."""
        high, wide = self._grid
        left, top, right, bottom = raster.box_of(screen, wide, high)
        n = self.samples
        return left // n * n, top // n * n, -(-right // n) * n, -(-bottom // n) * n

    def _pixels(self, samples: Box) -> Box:
        """A box of samples as one of pixels."""
        left, top, right, bottom = (side // self.samples for side in samples)
        return left, top, right, bottom

    def _rays(self) -> NDArray[np.float32]:
        """The affine map from samples to ray directions: the corner's, and what a step to the right or down adds."""
        high, wide = self._grid
        right, up, back = self.camera.axes
        corner = -back - right * (wide / 2) / self._focal + up * (high / 2) / self._focal
        return np.stack([corner, right / self._focal, -up / self._focal]).astype(np.float32)

    def _light_space(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """The (3, 4) map from world to shadow texels and height towards the light, around what the camera looks at."""
        target = np.array(self.camera.target)
        is_near = np.linalg.norm(np.array(self.camera.position) - target) < NEAR_M
        metres = SHADOW_METRES / 2 if is_near else SHADOW_METRES
        side = np.cross([0.0, 1.0, 0.0], light)
        side /= np.linalg.norm(side)
        axes = np.stack([side, np.cross(light, side), light])
        middle = axes @ (target if is_near else self._bounds[0].mean(0))
        scale = np.array([SHADOW_TEXELS / metres] * 2 + [1.0])
        shift = np.array([SHADOW_TEXELS / 2] * 2 + [0.0]) - scale * middle
        return np.concatenate([axes * scale[:, None], shift[:, None]], 1).astype(np.float32)
