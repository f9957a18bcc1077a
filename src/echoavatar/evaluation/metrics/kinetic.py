"""Kinetic features of a dance (AIST++ after Onuma 2008; Bailando), the input of FID_k and Div_k.

Three numbers for each joint, averaged over the clip: squared horizontal speed, squared vertical speed, and acceleration
("energy"). Velocity and acceleration are means over +-2 frames. The published code has a misplaced parenthesis: its
"acceleration" is (v - (p_t - p_(t-1) / dt)) / dt, dominated by where the joint is, not by how it moves. We have both.
"""

import numpy as np
from jaxtyping import Float

WINDOW = 2
AIST_RATE_HZ = 60.0


def kinetic_features(
    positions: Float[np.ndarray, "t j 3"],
    *,
    fps: float = AIST_RATE_HZ,
    up: int = 1,
    is_published: bool = True,
) -> Float[np.ndarray, " 3*j"]:
    """3 values for each joint: horizontal m2/s2, vertical m2/s2, acceleration m/s2.

    Positions are relative to the root in the first frame. `is_published` keeps the misplaced parenthesis of the
    published features; False gives the real acceleration.
    """
    place = np.asarray(positions, np.float64) - positions[:1, :1]
    flat = [axis for axis in range(3) if axis != up]
    step = np.diff(place, axis=0) * fps  # step k ends at frame k + 1
    velocity = _windowed(np.concatenate([np.full_like(step[:1], np.nan), step]))[1:]
    before = place[1:-1] - place[:-2] * fps if is_published else step[:-1]
    change = np.full_like(place, np.nan)
    change[1:-1] = (step[1:] - before) * fps
    energy = np.linalg.norm(_windowed(change)[1:], axis=-1).mean(0)
    horizontal = (velocity[..., flat] ** 2).sum(-1).mean(0)
    vertical = (velocity[..., up] ** 2).mean(0)
    return np.stack([horizontal, vertical, energy], -1).reshape(-1)


def _windowed(values: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t j 3"]:
    """Mean over the values within the window that are known."""
    wide = np.pad(values, ((WINDOW, WINDOW), (0, 0), (0, 0)), constant_values=np.nan)
    return np.asarray(np.nanmean([wide[k : k + len(values)] for k in range(2 * WINDOW + 1)], axis=0))
