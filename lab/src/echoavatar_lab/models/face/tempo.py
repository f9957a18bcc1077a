"""Speed perturbation: a clip's sound and curves, faster or slower.

Paper, Face Animation Generator: "temporal speed perturbation with factors {0.9, 1.0, 1.1} using cubic interpolation for
motion and time-stretch for audio". The stretch keeps the pitch: overlapping windows, each laid where it fits best.
"""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from echoavatar.timing import SAMPLES_PER_FRAME

from .clip import FaceClip

SPEEDS = (0.9, 1.0, 1.1)
_HOP = 360  # 15 ms
_SEARCH = 160  # samples to either side


def at_speed(clip: FaceClip, speed: float) -> FaceClip:
    """The clip at this multiple of its speed; 1.1 is shorter."""
    if speed == 1.0:
        return clip
    frames = max(2, round(len(clip.curves) / speed))
    audio = stretch(clip.audio, frames * SAMPLES_PER_FRAME)
    return FaceClip(f"{clip.name}-{speed:g}", audio, resample_curves(clip.curves, frames), clip.split)


def resample_curves(curves: Float[np.ndarray, "t c"], frames: int) -> Float[np.ndarray, "n c"]:
    """Curves resampled to `frames` frames by cubic splines through the frames' middles; clipped to 0..1."""
    if len(curves) < 2:
        return np.repeat(curves, frames, axis=0)
    middles = (np.arange(frames) + 0.5) * len(curves) / frames - 0.5
    spline = CubicSpline(np.arange(len(curves)), curves, axis=0)
    return np.asarray(np.clip(spline(np.clip(middles, 0, len(curves) - 1)), 0, 1), np.float32)


def stretch(audio: Float[np.ndarray, " s"], samples: int) -> Float[np.ndarray, " n"]:
    """The sound stretched to this many samples at its own pitch (WSOLA: overlap-add, aligned by correlation)."""
    window = np.hanning(2 * _HOP + 1)[:-1]
    edge = 2 * _HOP + 2 * _SEARCH
    source = np.pad(audio, edge).astype(np.float64)
    out = np.zeros(samples + 2 * edge)
    ratio = len(audio) / max(samples, 1)
    taken = edge - _HOP
    for start in range(0, samples + _HOP, _HOP):
        ideal = edge - _HOP + round(start * ratio)
        if start:
            taken = ideal + _best_shift(source, wanted=taken + _HOP, ideal=ideal)
        taken = min(max(taken, 0), len(source) - 2 * _HOP)
        out[start : start + 2 * _HOP] += window * source[taken : taken + 2 * _HOP]
    return out[_HOP : _HOP + samples].astype(np.float32)


def _best_shift(source: Float[np.ndarray, " s"], *, wanted: int, ideal: int) -> int:
    """The shift near `ideal` at which the sound is most like the natural continuation."""
    pattern = source[wanted : wanted + 2 * _HOP]
    first = max(ideal - _SEARCH, 0)
    region = source[first : ideal + _SEARCH + 2 * _HOP]
    if len(pattern) < 2 * _HOP or len(region) <= 2 * _HOP or not pattern.any():
        return 0
    likeness = np.correlate(region, pattern, mode="valid")
    energy = np.convolve(region**2, np.ones(2 * _HOP), mode="valid")
    shifts = first + np.arange(len(likeness)) - ideal
    nearer = 1 - 0.02 * np.abs(shifts) / _SEARCH  # a periodic sound fits at every period: prefer near shifts
    return int(shifts[np.argmax(nearer * likeness / np.sqrt(energy + 1e-6))])
