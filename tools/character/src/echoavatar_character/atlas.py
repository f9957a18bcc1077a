"""The atlas: one picture for skin, mouth and eyes. The face gets most of its area.

Places are (u, v) in 0..1 with v downwards, as glTF has them; rectangles are (left, top, right, bottom).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numba import njit

SIZE = 2048
EYE = (0.66, 0.64, 0.90, 0.88)
TEETH = (0.92, 0.66, 0.98, 0.72)
TONGUE = (0.92, 0.74, 0.98, 0.80)
LASH = (0.92, 0.82, 0.98, 0.88)


class Island(NamedTuple):
    """A rectangle of the base mesh's UV map, where it goes, and knots that give a part of it more room."""

    source: tuple[float, float, float, float]
    goal: tuple[float, float, float, float]
    u_knots: tuple[tuple[float, ...], tuple[float, ...]] = ((0, 1), (0, 1))
    v_knots: tuple[tuple[float, ...], tuple[float, ...]] = ((0, 1), (0, 1))


ISLANDS = (
    Island(
        (0.64, 0.18, 1.0, 0.855),
        (0.005, 0.005, 0.645, 0.995),
        ((0, 0.45, 0.90, 1), (0, 0.16, 0.90, 1)),
        ((0, 0.28, 0.38, 0.62, 0.72, 1), (0, 0.11, 0.22, 0.78, 0.89, 1)),
    ),
    Island((0.355, 0.79, 0.775, 1.0), (0.65, 0.005, 0.995, 0.19)),
    Island((0.75, 0.855, 0.935, 1.0), (0.65, 0.20, 0.82, 0.35)),
    Island((0.0, 0.36, 0.16, 0.46), (0.83, 0.20, 0.995, 0.35)),
    Island((0.0, 0.0, 0.76, 0.60), (0.65, 0.36, 0.995, 0.62)),
)


def placed(uvs: Float[np.ndarray, "f 4 2"]) -> Float[np.ndarray, "f 4 2"]:
    """UVs of the base mesh's body (v downwards) in the atlas; a quad goes with the island of its middle."""
    out = np.zeros_like(uvs)
    middle = uvs.mean(1)
    for island in reversed(ISLANDS):
        left, top, right, bottom = island.source
        inside = (middle[:, 0] >= left) & (middle[:, 0] < right) & (middle[:, 1] >= top) & (middle[:, 1] < bottom)
        if island is ISLANDS[3]:
            inside &= middle[:, 0] < 0.155
        u = np.interp((uvs[inside, :, 0] - left) / (right - left), *island.u_knots)
        v = np.interp((uvs[inside, :, 1] - top) / (bottom - top), *island.v_knots)
        a, b, c, d = island.goal
        out[inside] = np.stack([a + (c - a) * u, b + (d - b) * v], -1)
    return out


def within(rect: tuple[float, float, float, float], uvs: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """UVs of 0..1 inside a rectangle of the atlas."""
    left, top, right, bottom = rect
    return np.asarray(np.array([left, top]) + uvs * np.array([right - left, bottom - top]))


def spread(
    uvs: Float[np.ndarray, "t 3 2"], values: Float[np.ndarray, "t 3 d"], size: int
) -> tuple[Float[np.ndarray, "h w d"], Float[np.ndarray, "h w"]]:
    """Draw values of triangles' corners into the atlas: the picture, and 1 where it is covered."""
    picture = np.zeros((size, size, values.shape[2]), np.float32)
    covered = np.zeros((size, size), np.float32)
    _spread(uvs.astype(np.float32) * size, values.astype(np.float32), picture, covered)
    return picture, covered


@njit(cache=True)
def _spread(uvs, values, picture, covered):  # type: ignore[no-untyped-def]
    size = covered.shape[0]
    for t in range(len(uvs)):
        ax, ay, bx, by, cx, cy = uvs[t, 0, 0], uvs[t, 0, 1], uvs[t, 1, 0], uvs[t, 1, 1], uvs[t, 2, 0], uvs[t, 2, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        for row in range(max(0, int(min(ay, by, cy)) - 1), min(size, int(max(ay, by, cy)) + 2)):
            for column in range(max(0, int(min(ax, bx, cx)) - 1), min(size, int(max(ax, bx, cx)) + 2)):
                x, y = column + 0.5, row + 0.5
                u = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                v = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                w = 1 - u - v
                slack = -0.02
                if u >= slack and v >= slack and w >= slack:
                    for d in range(picture.shape[2]):
                        picture[row, column, d] = u * values[t, 0, d] + v * values[t, 1, d] + w * values[t, 2, d]
                    covered[row, column] = 1


def filled(picture: Float[np.ndarray, "h w d"], covered: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w d"]:
    """The picture with the nearest covered texel in every gap, so that filtering finds no border."""
    from scipy.ndimage import distance_transform_edt

    _, (rows, columns) = distance_transform_edt(covered < 0.5, return_indices=True)
    return np.asarray(picture[rows, columns])


def noise(points: Float[np.ndarray, "... 3"], scale: float, seed: int) -> Float[np.ndarray, "..."]:
    """Smooth noise of space, about -1 to 1; `scale` is the size of its features in metres."""
    rng = np.random.default_rng(seed)
    grid = rng.standard_normal((32, 32, 32)).astype(np.float32)
    from scipy.ndimage import map_coordinates

    flat = (np.asarray(points, np.float64) / scale).reshape(-1, 3).T
    return np.asarray(map_coordinates(grid, flat, order=1, mode="grid-wrap").reshape(points.shape[:-1]))


def corners(per: Float[np.ndarray, "f 4 d"]) -> Float[np.ndarray, "t 3 d"]:
    """Values of the quads' corners at the corners of their triangles."""
    return np.concatenate([per[:, [0, 1, 2]], per[:, [0, 2, 3]]])
