"""Beat alignment (paper, appendix Beat Alignment): do motion beats fall on speech onsets and music beats?

BA = mean over audio events of exp(-d^2 / 2 sigma^2), d the distance in seconds to the nearest motion beat.
- speech (BA_G): motion beats of a joint are local minima of its speed; averaged over the arm joints.
- music (BA_D): motion beats are local maxima of the deceleration of the mean joint speed.

The paper leaves sigma and smoothing open. Ours: sigma 0.06 s, because with the usual 0.3 s any lively motion scores
near 1; positions are smoothed a little (sigma one frame), so that minima are those of a movement and not of noise.
The score says nothing alone, so every score comes with its chance level: the same motion against other clips' events.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from ..timing import FRAME_RATE_HZ

SIGMA_SECONDS = 0.06
SMOOTHING_FRAMES = 1.0
STROKE_DELAY_SECONDS = 0.18
"""Rehearsal gestures end 0.14 to 0.18 s after the stressed vowel and a wrist is slowest just after; the alignment of
motion to rehearsal speech, generated and true alike, is measured at this delay. Recordings are measured at none."""
ARM_JOINTS = ("leftLowerArm", "leftHand", "rightLowerArm", "rightHand")


def speech_motion_beats(positions: Float[np.ndarray, "t j 3"]) -> list[Float[np.ndarray, " n"]]:
    """Per joint the times (s) of its speed minima, those below its mean speed only."""
    speed = _speed(positions)
    beats = []
    for joint in speed.T:
        at = find_peaks(-joint, height=-joint.mean(), distance=3)[0]
        beats.append((at + 0.5) / FRAME_RATE_HZ)
    return beats


def dance_motion_beats(positions: Float[np.ndarray, "t j 3"]) -> list[Float[np.ndarray, " n"]]:
    """Times (s) of the maxima of deceleration of the mean joint speed."""
    speed = _speed(positions).mean(1)
    braking = -np.diff(speed)
    return [(find_peaks(braking, height=0.0, distance=3)[0] + 1.0) / FRAME_RATE_HZ]


def alignment(
    events: Float[np.ndarray, " n"], beats: Sequence[Float[np.ndarray, " m"]], sigma: float = SIGMA_SECONDS
) -> float:
    """Mean hit of the audio events by the nearest motion beat, averaged over joints; NaN without events."""
    if not len(events):
        return float("nan")
    scores = []
    for times in beats:
        if len(times):
            distance = np.abs(np.asarray(events)[:, None] - times[None]).min(1)
            scores.append(float(np.exp(-(distance**2) / (2 * sigma**2)).mean()))
        else:
            scores.append(0.0)
    return float(np.mean(scores))


def alignment_and_chance(
    events: Sequence[Float[np.ndarray, " n"]], beats: Sequence[Sequence[Float[np.ndarray, " m"]]]
) -> tuple[float, float]:
    """BA over clips, and the chance level: each clip's motion against the events of every other clip."""
    clips = [i for i, times in enumerate(events) if len(times)]
    own = [alignment(events[i], beats[i]) for i in clips]
    other = [alignment(_within(events[j], events[i]), beats[i]) for i in clips for j in clips if i != j]
    other = [score for score in other if np.isfinite(score)]
    return float(np.mean(own)) if own else float("nan"), float(np.mean(other)) if other else float("nan")


def speed_around(
    positions: Float[np.ndarray, "t j 3"], events: Float[np.ndarray, " n"], seconds: tuple[float, float]
) -> Float[np.ndarray, " m"]:
    """Mean joint speed between these times around each event, over its mean from a second before to a second after."""
    speed = _speed(positions).mean(1)
    first, last = (round(second * FRAME_RATE_HZ) for second in seconds)
    at = np.round(np.asarray(events) * FRAME_RATE_HZ).astype(int)
    at = at[(at >= FRAME_RATE_HZ) & (at + FRAME_RATE_HZ < len(speed))]
    near = [speed[k + first : k + last + 1].mean() for k in at]
    wide = [speed[k - FRAME_RATE_HZ : k + FRAME_RATE_HZ].mean() + 1e-6 for k in at]
    return np.asarray(np.array(near) / np.array(wide))


def speech_onsets(audio: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " n"]:
    """Acoustic onsets (s) by librosa's detector, as the paper does."""
    librosa = _librosa()
    return np.asarray(librosa.onset.onset_detect(y=audio, sr=rate, hop_length=512, units="time"), np.float64)


def music_beats(audio: Float[np.ndarray, " s"], rate: int) -> Float[np.ndarray, " n"]:
    """Beats (s) by librosa's tracker, for recordings whose beats are not known."""
    _, times = _librosa().beat.beat_track(y=audio, sr=rate, hop_length=256, units="time")
    return np.asarray(times, np.float64)


def _within(events: Float[np.ndarray, " n"], own: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
    """Another clip's events that fall inside the stretch where ours lie."""
    return np.asarray(events[(events >= own.min()) & (events <= own.max())])


def _speed(positions: Float[np.ndarray, "t j 3"]) -> Float[np.ndarray, "t-1 j"]:
    smooth = gaussian_filter1d(positions, SMOOTHING_FRAMES, axis=0, mode="nearest")
    return np.asarray(np.linalg.norm(np.diff(smooth, axis=0), axis=-1) * FRAME_RATE_HZ)


def _librosa() -> Any:
    from ..errors import DependencyError

    try:
        import librosa
    except ImportError as error:
        raise DependencyError(
            "beat alignment needs librosa; run: pip install 'echoavatar[evaluate]'"
        ) from error
    return librosa
