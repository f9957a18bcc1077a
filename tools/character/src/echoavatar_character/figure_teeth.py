"""Teeth and tongue: small structured meshes behind the lips of the closed mouth (metres, rest pose)."""

import numpy as np
from jaxtyping import Float, Int

from .figure_mouth import ARCH, TEETH
from .sculpt import Mesh, outward

ENAMEL, GAP_SHADE, GUM, TONGUE = (240, 234, 220), (206, 194, 176), (196, 104, 104), (198, 98, 100)
BORDERS = (0.0, 0.0085, 0.0150, 0.0200, 0.0240, 0.0280)  # between teeth: x along the row, middle to the side
# height above the lips' line and depth behind the front of the row, from the gum over the edge to the back
UPPER = (
    (0.0165, 0.0035), (0.0105, 0.0012), (0.0095, 0.0), (0.0040, 0.0), (-0.0012, 0.0008), (-0.0012, 0.0030),
    (0.0090, 0.0060),
)  # fmt: skip
LOWER = (
    (-0.0180, 0.0065), (-0.0125, 0.0042), (-0.0115, 0.0030), (-0.0060, 0.0028), (-0.0018, 0.0034), (-0.0018, 0.0050),
    (-0.0110, 0.0080),
)  # fmt: skip
HEIGHT = 1.5195


def teeth(*, upper: bool) -> tuple[Mesh, Float[np.ndarray, "v 3"]]:
    """One row of teeth with its gum, and its colours (sRGB, 0..255)."""
    x, notch = _along()
    profile = np.asarray(UPPER if upper else LOWER)
    squeeze = 1.0 if upper else 0.94
    depth = profile[None, :, 1] + 0.0009 * notch[:, None] * (np.arange(len(profile)) > 1)
    height = np.tile(profile[:, 0], (len(x), 1))
    edge = [4, 5]
    height[:, edge] += (0.0006 if upper else -0.0005) * (notch + (x / 0.03) ** 2)[:, None]
    wide = x[:, None] * squeeze
    points = np.stack([np.broadcast_to(wide, height.shape), HEIGHT + height, TEETH - depth - ARCH * wide**2], axis=-1)
    colours = np.empty(points.shape)
    colours[:] = np.asarray(ENAMEL) + (np.asarray(GAP_SHADE) - ENAMEL) * notch[:, None, None]
    colours[:, :2] = GUM
    colours *= np.clip(1.05 - 0.45 * (np.abs(x) / 0.028) ** 2, 0, 1)[:, None, None]  # it is dark at the back
    return _sheet(points, colours, outside=np.array([0.0, HEIGHT, 0.055]))


def tongue() -> tuple[Mesh, Float[np.ndarray, "v 3"]]:
    """The tongue, its tip behind the lower teeth."""
    around, along = np.linspace(0, 2 * np.pi, 19), np.linspace(0.02, np.pi - 0.02, 13)
    a, b = np.meshgrid(around, along)
    sides, forward = np.sin(b) ** 0.7, -np.cos(b)
    width = 0.0165 * (1 - 0.25 * np.maximum(forward, 0))
    x = width * sides * np.cos(a)
    groove = 0.0016 * np.exp(-((x / 0.004) ** 2)) * (np.sin(a) > 0)
    thick = 0.0062 - 0.0022 * np.maximum(forward, 0)
    y = 1.5085 + 0.0025 * (1 - forward) + thick * sides * np.sin(a) - groove
    points = np.stack([x, y, 0.0495 + 0.0265 * forward], axis=-1)
    colours = np.empty(points.shape)
    colours[:] = np.asarray(TONGUE) * np.clip(0.55 + 0.45 * forward, 0.25, 1)[..., None]
    return _sheet(points, colours, outside=np.array([0.0, 1.5085, 0.05]))


def vertex_normals(points: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "v 3"]:
    """Unit normals from the triangles around each vertex, by their areas."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for corner in triangles.T:
        np.add.at(normals, corner, face)
    unit: Float[np.ndarray, "v 3"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return unit


def _along() -> tuple[Float[np.ndarray, " u"], Float[np.ndarray, " u"]]:
    """Places along a row, right to left, and how deep the notch between two teeth is there."""
    half: list[tuple[float, float]] = [(BORDERS[0], 1.0)]
    for start, end in zip(BORDERS[:-1], BORDERS[1:], strict=True):
        half += [(start + (end - start) * t, 0.0) for t in (0.18, 0.5, 0.82)] + [(end, 1.0)]
    x, notch = np.asarray(half).T
    return np.concatenate([-x[:0:-1], x]), np.concatenate([notch[:0:-1], notch])


def _sheet(
    points: Float[np.ndarray, "u w 3"], colours: Float[np.ndarray, "u w 3"], *, outside: Float[np.ndarray, " 3"]
) -> tuple[Mesh, Float[np.ndarray, "v 3"]]:
    """A grid as a mesh whose triangles look away from `outside`."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    flat = points.reshape(-1, 3)
    faces = outward(flat, flat - outside, faces.astype(np.int32))
    normals = vertex_normals(flat, faces)
    return Mesh(flat.astype(np.float32), normals.astype(np.float32), faces), colours.reshape(-1, 3)
