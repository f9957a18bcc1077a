"""Rows of `echoavatar score`: how much the body moves and varies (`metrics.liveliness`)."""

from collections.abc import Sequence

import numpy as np

from echoavatar.motion.kinematics import Motion

from .metrics.liveliness import STATISTICS, body_points, liveliness, windows
from .motion_folder import Pair
from .score_row import Row, row_of_means

WINDOW_S = 30.0


def liveliness_rows(pairs: Sequence[Pair], *, seed: int = 0) -> list[Row]:
    """A row for each statistic: the mean over windows of 30 s of each clip; shorter clips are one window."""
    made = np.array([clip_statistics(pair.made) for pair in pairs])
    true = np.array([clip_statistics(pair.true) for pair in pairs])
    weights = np.array([pair.made.frames for pair in pairs], float)
    return [
        row_of_means(name, unit, made[:, column], truths=true[:, column], weights=weights, seed=seed)
        for column, (name, unit) in enumerate(STATISTICS.items())
    ]


def clip_statistics(motion: Motion) -> list[float]:
    """Each statistic's mean over the windows that have it."""
    rows = [liveliness(part, motion.fps) for part in windows(body_points(motion), motion.fps, WINDOW_S)]
    known = [[row[name] for row in rows if np.isfinite(row[name])] for name in STATISTICS]
    return [float(np.mean(values)) if values else float("nan") for values in known]
