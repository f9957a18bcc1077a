"""Draw a pose as a picture; films, live video and virtual cameras all use this module."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from .character import Character
from .framing import View, aimed, followed
from .gpu_render import GpuRenderer
from .render import Box, Camera, Paint, Renderer, Surface
from .skinning import skin

RendererName = Literal["cpu", "gpu"]
RENDERERS: dict[RendererName, type[Renderer]] = {"cpu": Renderer, "gpu": GpuRenderer}


@dataclass(frozen=True)
class Shot:
    """The settings of a picture: size in pixels, view, background, and samples a pixel along each axis.

    With `alpha` pictures have a fourth channel and no backdrop. `renderer` is our rasteriser on the processor, or
    OpenGL on a graphics card.
    """

    size: tuple[int, int] = (1280, 720)
    view: View = "front"
    background: str = "studio"
    alpha: bool = False
    samples: int = 2
    renderer: RendererName = "cpu"


class AvatarRenderer:
    """Draws one character's poses; for one thread at a time. Several renderers may share a character's `Paint`."""

    def __init__(self, character: Character, shot: Shot, paint: Paint | None = None) -> None:
        """Raises MotionError where there is no such background, DependencyError where there is no OpenGL for `gpu`."""
        self.shot, self.paint = shot, paint or Paint.of(character)
        self.character = character
        make = RENDERERS[shot.renderer]
        self._renderer = make(*shot.size, samples=shot.samples, background=shot.background, alpha=shot.alpha)

    def draw(
        self,
        rotations: Float[np.ndarray, "j 3 3"],
        positions: Float[np.ndarray, "j 3"],
        face: Float[np.ndarray, " n"] | None = None,
        camera: Camera | None = None,
    ) -> UInt8[np.ndarray, "h w c"]:
        """The picture of world rotations and positions, sRGB; without `camera`, the shot's view follows the body."""
        view, who = self.shot.view, self.character
        joint, size = followed(view, who)
        self._renderer.camera = camera or aimed(view, positions[joint], size)
        points, normals = skin(who, rotations, positions, face)
        return self._renderer.draw(Surface(points, normals, self.paint))

    @property
    def backdrop(self) -> UInt8[np.ndarray, "h w c"]:
        """The picture without the character."""
        return self._renderer.empty

    @property
    def drawn(self) -> tuple[Box, ...]:
        """The boxes outside which the last picture is the backdrop."""
        return self._renderer.drawn

    def twin(self) -> "AvatarRenderer":
        """Another renderer of the same character, for another thread."""
        return AvatarRenderer(self.character, self.shot, self.paint)
