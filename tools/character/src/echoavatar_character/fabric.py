"""Pictures of cloth that repeat: a plain knit and a twill, as grey factors on the garment's colour, and normal maps."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter


def knit(size: int = 256, columns: int = 14, rows: int = 18) -> Float[np.ndarray, "s s"]:
    """Stocking stitch: columns of V, each leg a rounded strand."""
    rng = np.random.default_rng(31)
    v, u = np.meshgrid(np.linspace(0, 1, size, False), np.linspace(0, 1, size, False), indexing="ij")
    x = (u * columns) % 1
    leg = np.abs(x - 0.5) * 2  # 0 in the middle of a column, 1 between columns
    y = (v * rows + 0.55 * (1 - leg)) % 1
    strand = np.sqrt(np.clip(1 - ((y - 0.5) / 0.5) ** 2, 0, 1)) * np.sqrt(np.clip(1 - ((leg - 0.52) / 0.5) ** 2, 0, 1))
    fuzz = gaussian_filter(rng.standard_normal((size, size)), 0.8, mode="wrap")
    return np.asarray(np.clip(0.62 + 0.36 * strand + 0.035 * fuzz, 0, 1))


def twill(size: int = 256, lines: int = 32) -> Float[np.ndarray, "s s"]:
    """Slanting ribs with the uneven threads of cotton."""
    rng = np.random.default_rng(37)
    v, u = np.meshgrid(np.linspace(0, 1, size, False), np.linspace(0, 1, size, False), indexing="ij")
    rib = 0.5 + 0.5 * np.cos(2 * np.pi * (u * lines + v * lines))
    slub = gaussian_filter(rng.standard_normal((size, size)), (7, 0.7), mode="wrap")
    slub += gaussian_filter(rng.standard_normal((size, size)), (0.7, 5), mode="wrap")
    slub /= slub.std()
    return np.asarray(np.clip(0.84 + 0.10 * rib + 0.035 * slub, 0, 1))


def normal_map(heights: Float[np.ndarray, "h w"], depth: float) -> Float[np.ndarray, "h w 3"]:
    """Normals of heights that repeat, as colours 0 to 1: x to the right, y upwards; a height of 1 is `depth` texels."""
    right = depth * (np.roll(heights, -1, 1) - np.roll(heights, 1, 1)) / 2
    down = depth * (np.roll(heights, -1, 0) - np.roll(heights, 1, 0)) / 2
    normals = np.stack([-right, down, np.ones_like(heights)], -1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True) / 2 + 0.5)
