"""Motion made by formula whose beats are known."""

import numpy as np


def swing(period_s: float, seconds: float = 20.0, joints: int = 1) -> np.ndarray:
    """Joints swinging along x so that they stand still every half period."""
    t = np.arange(int(seconds * 30)) / 30
    place = np.zeros((len(t), joints, 3))
    place[..., 0] = np.cos(2 * np.pi * t / period_s)[:, None]
    return place
