"""Variety of motion (paper, appendix L1 Diversity). The best value is the truth's.

    Div = (1/N) sum over frames and joints of |p - mean of p over its clip|_1,   root at the origin, metres

The sum runs over the three axes of all joints, so the value grows with their number: 55 joints of SMPL-X in the
published tables, all joints of our rig here. Frames of all clips count equally (N is their total). The published code
overwrites its input positions with |p - mean|; scripts that score beats afterwards score that instead of the motion.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def l1_deviation(positions: Float[np.ndarray, "t j 3"]) -> float:
    """Diversity of one clip in metres: mean over frames of the summed deviation from the clip's mean pose."""
    values = np.asarray(positions, np.float64)
    return float(np.abs(values - values.mean(0)).sum() / len(values))


def l1_diversity(clips: Sequence[Float[np.ndarray, "_ j 3"]]) -> float:
    """Diversity of all clips, weighted by length; positions must be relative to the root."""
    return float(np.average([l1_deviation(clip) for clip in clips], weights=[len(clip) for clip in clips]))
