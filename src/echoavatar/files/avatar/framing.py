"""Where the camera stands: live it follows the body; in a film it knows the whole take, and all of the body is seen."""

import math
from itertools import product
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics.windows import weighted_mean, windows

from .character import Character
from .render import Camera

View = Literal["front", "left", "right", "back", "bust", "face"]  # left and right are the character's
VIEWS: tuple[View, ...] = get_args(View)
CLOSE: tuple[View, ...] = ("bust", "face")
SIZES = {"wide": (1280, 720), "portrait": (720, 1280), "square": (720, 720)}  # pixels
FOLLOW_SECONDS = 0.7  # standard deviation of the window that smooths the path of a close camera
_TURNS = {"front": 0.0, "left": 75.0, "right": -90.0, "back": 180.0}  # degrees of the camera about the body
_BESIDE, _ABOVE, _BEFORE = 0.55, 0.42, 3.9  # metres from the body to the camera
_FIELD = 0.52  # radians
_SHARE = 0.92  # of the picture that the body may fill
_HOLDS = (math.inf, 4.0, 2.0, 1.0)  # seconds before and after a frame over which the camera's path is smoothed
_FARTHER = 1.2  # a calmer camera stands at most so many times as far away as the quickest
_FRAMES = 256  # that are computed together
Array = np.ndarray


def picture_size(wanted: tuple[int, int] | str | None, view: View = "front") -> tuple[int, int]:
    """Width and height in pixels of a film: those given, those of a shape in `SIZES`, or what suits the view.

    Raises MotionError: there is no such shape.
    """
    if isinstance(wanted, tuple):
        return wanted
    name = wanted or ("square" if view in CLOSE else "wide")
    if name not in SIZES:
        raise MotionError(f"there is no size {name!r}; choose {', '.join(SIZES)}, or width and height in pixels")
    return SIZES[name]


def followed(view: View, character: Character) -> tuple[int, float]:
    """The joint that the camera follows, and the size of the part of the body that it shows, over that of ours."""
    return (character.head, character.sizes[1]) if view in CLOSE else (0, character.sizes[0])


def aimed(view: View, at: Float[Array, " 3"], size: float = 1.0) -> Camera:
    """The camera of a view; `at` is where the hips are, or the head in a close view, in metres.

    `size` is that of the body, or of the head in a close view, over that of ours.
    """
    x, y, z = map(float, at)
    if view == "face":
        return Camera((x + 0.11 * size, y + 0.07 * size, z + 0.90 * size), (x, y + 0.05 * size, z), 0.33)
    if view == "bust":
        return Camera((x + 0.22 * size, y - 0.02 * size, z + 1.45 * size), (x, y - 0.12 * size, z), 0.50)
    target = np.array([x, 0.93 * size, z])
    return _camera(target + size * _offset(view), target)


def path(
    view: View,
    size: tuple[int, int],
    character: Character,
    rotations: Float[Array, "t j 3 3"],
    positions: Float[Array, "t j 3"],
    fps: float,
) -> list[Camera]:
    """The camera of each frame of a take; `size` is that of the picture in pixels.

    It looks the same way all the time and moves as little as a large picture of the body allows.
    """
    if view in CLOSE:
        joint, times = followed(view, character)
        deviations = np.arange(4 * FOLLOW_SECONDS * fps + 1) / (FOLLOW_SECONDS * fps)
        bell = np.exp(-0.5 * np.append(-deviations[:0:-1], deviations) ** 2)
        heads = weighted_mean(positions[:, joint], bell)
        return [aimed(view, place, times) for place in heads]
    away = _offset(view)
    axes = _camera(away, 0 * away).axes
    high = _SHARE * math.tan(_FIELD / 2)
    slopes = np.array([high * size[0] / size[1], high])
    edges = _edges(character, rotations, positions, axes, slopes)
    places = _places(edges, positions[:, 0] @ axes.T, slopes, fps) @ axes
    return [_camera(place, place - away) for place in places]


def _camera(place: Float[Array, "3"], target: Float[Array, "3"]) -> Camera:
    (a, b, c), (x, y, z) = place.tolist(), target.tolist()
    return Camera((a, b, c), (x, y, z), _FIELD)


def _offset(view: View) -> Float[Array, "3"]:
    """From the body to the camera, metres."""
    turn = math.radians(_TURNS[view])
    across, along = np.array([math.cos(turn), 0, -math.sin(turn)]), np.array([math.sin(turn), 0, math.cos(turn)])
    return np.asarray(_BESIDE * across + _BEFORE * along + [0, _ABOVE, 0])


def _edges(
    character: Character,
    rotations: Float[Array, "t j 3 3"],
    positions: Float[Array, "t j 3"],
    axes: Float[Array, "3 3"],
    slopes: Float[Array, "2"],
) -> Float[Array, "t 2 2"]:
    """Least and greatest of what each axis of the picture has to show.

    A camera at (x, z) sees a point at (p, q), right and backward, if x + slope z >= p + slope q and
    x - slope z <= p - slope q. So the greatest p + slope q and the least p - slope q speak for the whole body.
    """
    bones, corners = character.boxes
    edges = np.empty((len(positions), 2, 2))
    for start in range(0, len(positions), _FRAMES):
        here = slice(start, start + _FRAMES)
        points = np.einsum("tbij,bkj->tbki", rotations[here][:, bones], corners) + positions[here][:, bones, None]
        seen = points.reshape(len(points), -1, 3) @ axes.T
        for axis, slope in enumerate(slopes):
            edges[here, axis, 0] = (seen[..., axis] - slope * seen[..., 2]).min(1)
            edges[here, axis, 1] = (seen[..., axis] + slope * seen[..., 2]).max(1)
    return edges


def _places(
    edges: Float[Array, "t 2 2"], hips: Float[Array, "t 3"], slopes: Float[Array, "2"], fps: float
) -> Float[Array, "t 3"]:
    """The camera's positions in its own axes: the calmest path that is not much farther away than the quickest."""
    found = []
    for aside, along in sorted(product(_HOLDS, repeat=2), key=sum, reverse=True):
        aim, depth = _smooth(hips[:, :2], aside, fps), _smooth(hips[:, 2], along, fps)
        aim = aim + _middle(edges.mean(2) - aim)
        needed = (np.abs(edges - aim[..., None]).max(2) / slopes).max(1) - depth
        far = depth + _smooth(windows(needed, 2 * _half(along, fps, len(aim))).max(-1), along, fps)
        found.append((float((far - hips[:, 2]).mean()), np.column_stack([aim, far])))
    most = _FARTHER * found[-1][0]
    return next(places for distance, places in found if distance <= most)


def _smooth(values: Array, hold: float, fps: float) -> Array:
    """Means over `hold` seconds before and after each frame, or the middle for all frames if `hold` is infinite."""
    if math.isinf(hold):
        return np.broadcast_to(_middle(values), values.shape)
    for _ in range(2):
        values = windows(values, _half(hold, fps, len(values))).mean(-1)
    return values


def _half(hold: float, fps: float, frames: int) -> int:
    return int(min(hold * fps, frames) / 2)


def _middle(values: Array) -> Array:
    return np.asarray((values.min(0) + values.max(0)) / 2)
