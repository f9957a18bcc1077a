"""The counts of a captured dance, found in its movement: dancers brake on them. Not in the paper.

Tempo by autocorrelation and counts by dynamic programming, as Ellis (2007) finds beats in sound. Salsa has steady
counts; in modern dance the counts follow the hits, which come at any distance.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from echoavatar.timing import FRAME_RATE_HZ

from ..sound import steadiest_path

COUNT_S = (0.28, 0.80)  # shortest and longest count
USUAL_S, SPREAD = 0.45, 0.7  # the count that people prefer, and how much, in powers of e
TIGHTNESS = 12.0  # of the tempo against the hits

Array = np.ndarray


def find_counts(positions: Float[np.ndarray, "t j 3"]) -> Float[Array, " n"]:
    """Frames of the counts of a dance at 30 fps, ascending; none for less than two seconds."""
    if len(positions) < 2 * FRAME_RATE_HZ:
        return np.zeros(0)
    hits = braking(positions)
    period = _count_frames(hits)
    frames = steadiest_path(hits, period, np.arange(max(4, round(0.65 * period)), round(1.5 * period) + 1), TIGHTNESS)
    return np.array([_between_frames(hits, frame) for frame in frames])


def braking(positions: Float[np.ndarray, "t j 3"]) -> Float[Array, " t"]:
    """How hard the body as a whole slows down in each frame, of unit deviation."""
    smooth = gaussian_filter1d(positions, 1.0, axis=0, mode="nearest")
    speed = np.linalg.norm(np.diff(smooth, axis=0), axis=-1).mean(1)
    slowing = np.pad(np.maximum(-np.diff(speed), 0), 1)
    return np.asarray(slowing / max(float(slowing.std()), 1e-9))


def _count_frames(hits: Float[Array, " t"]) -> float:
    """Frames from count to count: the highest peak of the autocorrelation near the usual count."""
    hits = hits - hits.mean()
    lags = np.arange(round(COUNT_S[0] * FRAME_RATE_HZ), min(round(COUNT_S[1] * FRAME_RATE_HZ), len(hits) // 2) + 1)
    match = np.array([_alike(hits, lag) + 0.5 * _alike(hits, 2 * lag) for lag in lags.tolist()])
    usual = np.exp(-0.5 * (np.log(lags / (USUAL_S * FRAME_RATE_HZ)) / SPREAD) ** 2)
    best = int(np.argmax((match - min(match.min(), 0.0)) * usual))
    return float(lags[best])


def _alike(hits: Float[Array, " t"], lag: int) -> float:
    """Autocorrelation at a lag in frames; 0 beyond the end."""
    return float((hits[lag:] * hits[:-lag]).mean()) if lag < len(hits) else 0.0


def _between_frames(hits: Float[Array, " t"], frame: int) -> float:
    """The top of the parabola through a hit and its neighbours."""
    if not 0 < frame < len(hits) - 1:
        return float(frame)
    left, top, right = hits[frame - 1 : frame + 2]
    bend = left - 2 * top + right
    return frame + float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < -1e-6 else float(frame)
