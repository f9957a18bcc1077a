"""Ambient occlusion of vertices: how much of the sky each sees past all others, from depth maps of many directions."""

import numpy as np
from jaxtyping import Float, Int

from echoavatar.files.avatar import raster

DIRECTIONS = 40
TEXELS = 1024


def openness(
    points: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    triangles: Int[np.ndarray, "f 3"],
    *,
    span: float,
    middle: Float[np.ndarray, " 3"],
    bias: float,
) -> Float[np.ndarray, " v"]:
    """1 in the open, 0 in a crack. Depth maps cover `span` metres around `middle`; `bias` metres hide no one."""
    seen, total = np.zeros(len(points)), np.zeros(len(points))
    shadow = np.zeros((TEXELS, TEXELS), np.float32)
    vertices, faces = points.astype(np.float32), triangles.astype(np.int32)
    both_sides = np.ones(len(faces), bool)
    golden = np.pi * (3 - np.sqrt(5))
    for i in range(DIRECTIONS):
        y = 1 - 1.75 * (i + 0.5) / DIRECTIONS
        ring = np.sqrt(max(0.0, 1 - y * y))
        light = np.array([ring * np.cos(golden * i), y, ring * np.sin(golden * i)])
        side = np.cross([0.0, 1.0, 0.02], light)
        side /= np.linalg.norm(side)
        axes = np.stack([side, np.cross(light, side), light])
        to_light = np.concatenate([axes, -(axes @ middle)[:, None]], axis=1).astype(np.float32)
        to_light[:2] *= TEXELS / span
        to_light[:2, 3] += TEXELS / 2
        raster.shadow_depth(vertices, faces, both_sides, to_light, np.empty_like(vertices), shadow)
        facing = np.clip(normals @ light, 0, 1) * (0.65 + 0.35 * y)
        lifted = (points + normals * bias - middle) @ axes.T
        columns = np.clip(lifted[:, 0] * TEXELS / span + TEXELS / 2, 0, TEXELS - 1).astype(int)
        rows = np.clip(lifted[:, 1] * TEXELS / span + TEXELS / 2, 0, TEXELS - 1).astype(int)
        free = np.clip(1 - (shadow[rows, columns] - lifted[:, 2] - bias * 0.4) / (2 * bias), 0, 1)
        seen += facing * free
        total += facing
    return seen / np.maximum(total, 1e-6)
