"""Lip motion from phone times: ARKit curves by rule, to train the face model on.

The paper captures a speaker with an iPhone; here the phone times are known. Each phone pulls every channel towards its
target with a weight that falls off around it (dominance blending after Cohen and Massaro), which models
coarticulation: rounding, for example, begins early. Closures are not blended: p, b, m always close the lips.

The caller chooses the channels and their order by name.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

from ..sound import SoundTrack
from .pronounce import VOWELS

_FINE = 8  # fine steps per frame
_FINE_HZ = _FINE * FRAME_RATE_HZ
_REACH_JAW_S, _REACH_LIPS_S = 0.045, 0.065  # decay of a phone's pull beyond its ends
_FLANK_S = 0.035  # time to close or open the lips
_REST_PULL = 0.6
_JAW_MOST = 0.8

_JAW, _FUNNEL, _PUCKER, _STRETCH, _SMILE, _LOWER, _UPPER, _TONGUE = range(8)
_CHANNELS: tuple[tuple[str, ...], ...] = (
    ("jawOpen",),
    ("mouthFunnel",),
    ("mouthPucker",),
    ("mouthStretchLeft", "mouthStretchRight"),
    ("mouthSmileLeft", "mouthSmileRight"),
    ("mouthLowerDownLeft", "mouthLowerDownRight"),
    ("mouthUpperUpLeft", "mouthUpperUpRight"),
    ("tongueOut",),
)

# phone: jaw, funnel, pucker, stretch, smile, lower lip down, upper lip up, tongue; pull on the jaw, pull on the lips
_TARGETS: dict[str, tuple[float, ...]] = {
    "aa": (0.58, 0.08, 0.00, 0.04, 0.00, 0.26, 0.10, 0.0, 1.0, 0.7),
    "ae": (0.50, 0.00, 0.00, 0.24, 0.10, 0.30, 0.16, 0.0, 1.0, 0.7),
    "ah": (0.40, 0.04, 0.00, 0.08, 0.00, 0.22, 0.08, 0.0, 0.9, 0.5),
    "ao": (0.46, 0.42, 0.14, 0.00, 0.00, 0.16, 0.06, 0.0, 1.0, 1.0),
    "ax": (0.22, 0.04, 0.00, 0.08, 0.00, 0.14, 0.05, 0.0, 0.5, 0.3),
    "eh": (0.38, 0.00, 0.00, 0.22, 0.08, 0.26, 0.12, 0.0, 0.9, 0.6),
    "er": (0.22, 0.30, 0.18, 0.00, 0.00, 0.14, 0.08, 0.0, 0.8, 0.8),
    "ih": (0.23, 0.00, 0.00, 0.26, 0.10, 0.20, 0.10, 0.0, 0.8, 0.6),
    "iy": (0.15, 0.00, 0.00, 0.38, 0.22, 0.20, 0.12, 0.0, 0.9, 0.8),
    "uh": (0.20, 0.26, 0.26, 0.00, 0.00, 0.12, 0.05, 0.0, 0.8, 0.8),
    "uw": (0.14, 0.26, 0.62, 0.00, 0.00, 0.08, 0.04, 0.0, 1.0, 1.2),
    "ow": (0.32, 0.40, 0.38, 0.00, 0.00, 0.12, 0.05, 0.0, 1.0, 1.1),
    "w": (0.12, 0.28, 0.62, 0.00, 0.00, 0.06, 0.03, 0.0, 0.9, 1.3),
    "r": (0.17, 0.28, 0.24, 0.00, 0.00, 0.12, 0.08, 0.0, 0.6, 0.8),
    "y": (0.14, 0.00, 0.00, 0.30, 0.14, 0.16, 0.10, 0.0, 0.7, 0.6),
    "l": (0.22, 0.00, 0.00, 0.08, 0.00, 0.18, 0.08, 0.1, 0.6, 0.3),
    "m": (0.05, 0.00, 0.04, 0.02, 0.00, 0.00, 0.00, 0.0, 1.6, 1.4),
    "f": (0.08, 0.00, 0.00, 0.06, 0.00, 0.00, 0.20, 0.0, 1.4, 1.4),
    "th": (0.15, 0.00, 0.00, 0.08, 0.00, 0.18, 0.10, 0.35, 1.0, 0.6),
    "t": (0.13, 0.00, 0.00, 0.12, 0.02, 0.16, 0.08, 0.0, 0.8, 0.3),
    "s": (0.06, 0.00, 0.00, 0.22, 0.06, 0.18, 0.10, 0.0, 1.3, 0.6),
    "sh": (0.09, 0.48, 0.26, 0.00, 0.00, 0.16, 0.10, 0.0, 1.3, 1.2),
    "k": (0.20, 0.00, 0.00, 0.06, 0.00, 0.14, 0.06, 0.0, 0.3, 0.15),
    "hh": (0.24, 0.00, 0.00, 0.04, 0.00, 0.14, 0.05, 0.0, 0.2, 0.1),
}  # fmt: skip
_LIKE = {
    "p": "m", "b": "m", "v": "f", "dh": "th", "d": "t", "n": "t", "dx": "t", "z": "s", "zh": "sh", "ch": "sh",
    "jh": "sh", "g": "k", "ng": "k", "axr": "er", "el": "l", "em": "m", "en": "t", "ix": "ih",
}  # fmt: skip
_GLIDES = {"ay": ("aa", "ih"), "aw": ("aa", "uh"), "oy": ("ao", "ih"), "ey": ("eh", "iy"), "ow": ("ow", "uw")}
_CLOSED = {"p": 1.0, "b": 1.0, "m": 1.0, "em": 1.0, "f": 0.6, "v": 0.6}


@dataclass(frozen=True)
class _Pull:
    """A mouth shape with its weights for jaw and lips between two times (seconds)."""

    start: float
    end: float
    shape: Float[np.ndarray, " c"]
    jaw: float
    lips: float


def lip_curves(track: SoundTrack, names: Sequence[str]) -> Float[np.ndarray, "t n"]:
    """Curves 0..1 of the named ARKit channels at 30 frames per second; channels that speech does not move stay 0.

    Frame t is the mouth at the middle of samples 800 t to 800 (t + 1). An unknown phone counts as a neutral vowel.
    """
    frames = len(track.audio) // SAMPLES_PER_FRAME
    place = {name: column for column, name in enumerate(names)}
    curves = np.zeros((frames, len(names)), np.float32)
    for name, fine in _fine_curves(track, frames * _FINE).items():
        if name in place:
            curves[:, place[name]] = _per_frame(fine)
    return curves


def _fine_curves(track: SoundTrack, steps: int) -> Mapping[str, Float[np.ndarray, " f"]]:
    """All moving channels at eight steps per frame."""
    time = (np.arange(steps) + 0.5) / _FINE_HZ
    shape = _blend(list(_pulls(track)), time)
    closure = _closure(track, time)
    shape[:, [_FUNNEL, _LOWER, _UPPER]] *= 1 - np.minimum(closure, 1)[:, None] * [0.5, 1.0, 0.4]
    full = np.clip((closure - 0.6) / 0.4, 0, 1)  # only a full closure presses the lips
    bite = np.clip(closure / 0.6, 0, 1) * (1 - full)
    found = {name: shape[:, i] for i, group in enumerate(_CHANNELS) for name in group}
    found["mouthClose"] = shape[:, _JAW] * closure
    found["mouthRollLower"] = 0.25 * full + 0.35 * bite
    found["mouthRollUpper"] = 0.22 * full
    found["mouthPressLeft"] = found["mouthPressRight"] = 0.25 * full
    return found


def _pulls(track: SoundTrack) -> Iterator[_Pull]:
    """Phones and the rests between them; a diphthong is two shapes in a row."""
    last = -10.0
    for start, end, name in track.phones:
        if name == "pau":
            continue
        if start - last > 0.08:
            yield _rest(last, start)
        last = end
        effort = _effort(track, start, end) if name in VOWELS else 1.0
        parts = _GLIDES.get(name, (name,))
        for i, part in enumerate(parts):
            a, b = (start + (end - start) * k / len(parts) for k in (i, i + 1))
            inset = 0.2 * (b - a)
            *shape, jaw, lips = _TARGETS.get(_LIKE.get(part, part), _TARGETS["ax"])
            target = np.array(shape)
            target[_JAW] = min(_JAW_MOST, target[_JAW] * effort)
            yield _Pull(a + inset, b - inset, target, jaw, lips)
    yield _rest(last, len(track.audio) / SAMPLE_RATE_HZ + 10)


def _rest(start: float, end: float) -> _Pull:
    """The closed mouth of a pause; a short pause has little weight."""
    inset = min(0.06, (end - start) / 3)
    strength = _REST_PULL * min(1.0, (end - start) / 0.2)
    return _Pull(start + inset, end - inset, np.zeros(len(_CHANNELS)), strength, strength)


def _effort(track: SoundTrack, start: float, end: float) -> float:
    """Scale of the jaw opening, 0.75 to 1.25 by the syllable's prominence."""
    middle = (start + end) / 2
    return next((0.75 + 0.5 * s.prominence for s in track.syllables if s.start <= middle <= s.end), 1.0)


def _blend(pulls: Sequence[_Pull], time: Float[np.ndarray, " f"]) -> Float[np.ndarray, "f c"]:
    """Mean of the shapes, weighted by pull; without any pull the mouth rests."""
    weights = np.full((len(time), 2), 1e-6)
    total = np.zeros((len(time), len(_CHANNELS)))
    for pull in pulls:
        margin = 4 * _REACH_LIPS_S
        first, last = np.searchsorted(time, (pull.start - margin, pull.end + margin))
        away = np.maximum(np.maximum(pull.start - time[first:last], time[first:last] - pull.end), 0)
        jaw = pull.jaw * np.exp(-((away / _REACH_JAW_S) ** 2))
        lips = pull.lips * np.exp(-((away / _REACH_LIPS_S) ** 2))
        weights[first:last] += np.stack([jaw, lips], 1)
        total[first:last, :1] += jaw[:, None] * pull.shape[:1]
        total[first:last, 1:] += lips[:, None] * pull.shape[1:]
    return np.concatenate([total[:, :1] / weights[:, :1], total[:, 1:] / weights[:, 1:]], 1)


def _closure(track: SoundTrack, time: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """The share of the jaw's opening that the lips close, 0..1."""
    closure = np.zeros(len(time))
    for start, end, name in track.phones:
        if name not in _CLOSED:
            continue
        first, last = np.searchsorted(time, (start - _FLANK_S, end + _FLANK_S))
        near = time[first:last]
        away = np.maximum(np.maximum(start - near, near - end), 0) / _FLANK_S
        bump = _CLOSED[name] * (0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1)))
        closure[first:last] = np.maximum(closure[first:last], bump)
    return closure


def _per_frame(fine: Float[np.ndarray, " f"]) -> Float[np.ndarray, " t"]:
    """Weighted mean around the middle of each frame (Hann window of two frames)."""
    window = np.hanning(2 * _FINE + 1)[1:-1]
    padded = np.pad(fine, _FINE - 1 + _FINE // 2, mode="edge")
    smooth = np.convolve(padded, window / window.sum(), mode="valid")
    frames = len(fine) // _FINE
    halves = smooth[_FINE - 1 :: _FINE][:frames] + smooth[_FINE::_FINE][:frames]
    return np.asarray(np.clip(halves / 2, 0, 1))
