"""Draw a pose as a picture; films, live video and virtual cameras all use this module."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, UInt8

from echoavatar.motion.kinematics import HUMANOID

from .character import Character
from .gpu_render import GpuRenderer
from .render import Camera, Paint, Renderer, Surface
from .skinning import skin

HEAD = HUMANOID.index("head")
View = Literal["front", "left", "right", "back", "bust", "face"]  # left and right are the character's
VIEWS: tuple[View, ...] = get_args(View)
RendererName = Literal["cpu", "gpu"]
RENDERERS: dict[RendererName, type[Renderer]] = {"cpu": Renderer, "gpu": GpuRenderer}
_TURNS = {"front": 0.0, "left": 75.0, "right": -90.0, "back": 180.0}  # degrees of the camera about the body
CLOSE: tuple[View, ...] = ("bust", "face")


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
        self._character = character
        make = RENDERERS[shot.renderer]
        self._renderer = make(*shot.size, samples=shot.samples, background=shot.background, alpha=shot.alpha)

    def draw(
        self,
        rotations: Float[np.ndarray, "j 3 3"],
        positions: Float[np.ndarray, "j 3"],
        face: Float[np.ndarray, " n"] | None = None,
        camera: Camera | None = None,
    ) -> UInt8[np.ndarray, "h w c"]:
        """The picture of world rotations and positions; without `camera`, that of the shot's view follows the body."""
        self._renderer.camera = camera or aimed(self.shot.view, positions[followed_joint(self.shot.view)])
        points, normals = skin(self._character, rotations, positions, face)
        return self._renderer.draw(Surface(points, normals, self.paint))

    def twin(self) -> "AvatarRenderer":
        """Another renderer of the same character, for another thread."""
        return AvatarRenderer(self._character, self.shot, self.paint)


def followed_joint(view: View) -> int:
    """The joint that the camera follows."""
    return HEAD if view in CLOSE else 0


def aimed(view: View, at: Float[np.ndarray, " 3"]) -> Camera:
    """The camera of a view; `at` is where the hips are, or the head in a close view, in metres."""
    x, y, z = (float(value) for value in at)
    if view == "face":
        return Camera((x + 0.10, y + 0.05, z + 0.82), (x, y + 0.03, z), 0.33)
    if view == "bust":
        return Camera((x + 0.22, y - 0.02, z + 1.45), (x, y - 0.12, z), 0.50)
    turn = math.radians(_TURNS[view])
    beside, before = 0.55, 3.9
    placed = (
        x + beside * math.cos(turn) + before * math.sin(turn),
        z - beside * math.sin(turn) + before * math.cos(turn),
    )
    return Camera((placed[0], 1.35, placed[1]), (x, 0.93, z))
