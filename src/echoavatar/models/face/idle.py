"""Procedural idle motion of the upper face: blinks, brow accents on loud syllables, small shifts of gaze.

Not in the paper, whose model was trained on captured faces that blink. Only channels that the face model does not move
are animated. Blinks and gaze depend on the session's seed and the frame number alone and go on in silence; the brows
also depend on the sound.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.nn import StreamState
from echoavatar.timing import SAMPLES_PER_FRAME

from ..noise import uniform_noise

_SALT = 0x69646C652D666163  # so that the noise differs from the flow head's
_BLINK_EVERY = 100  # frames (3.3 s); each holds one blink; some are left out, some are double
_BLINK = (0.0, 0.35, 0.9, 1.0, 0.8, 0.5, 0.25, 0.08, 0.0)  # lids, frame by frame
_BLINKS, _DOUBLES, _DOUBLE_AFTER = 0.85, 0.12, 9
_GAZE_EVERY = 45  # frames
_GAZE_HOME = 0.55  # share of the time with the gaze on the viewer
_GAZE_YAW, _GAZE_PITCH = 0.25, 0.14
_GAZE_FRAMES = 2.0  # of a saccade
_BROW_GATE_EVERY = 24
_FAST, _SLOW, _RISE, _FALL = 0.5, 0.04, 0.4, 0.1  # one-pole weights per frame
_FAINTEST_DB = -60.0
_LOOKS = ("OutLeft", "InRight", "InLeft", "OutRight", "UpLeft", "UpRight", "DownLeft", "DownRight")
_BROWS = ("browInnerUp", "browOuterUpLeft", "browOuterUpRight")
_NAMES = ("eyeBlinkLeft", "eyeBlinkRight", *(f"eyeLook{way}" for way in _LOOKS), *_BROWS)
_COLUMNS = [ARKIT_NAMES.index(name) for name in _NAMES]


@dataclass
class IdleState(StreamState):
    """All zero: no frame yet."""

    seen: Int[np.ndarray, " b"]  # frames so far
    brows: Float[np.ndarray, "b 3"]  # fast and slow means of the loudness, and how far the brows are up


class IdleFace:
    """Adds idle motion to curves. `moving` (52) is true for the channels that the face model moves itself."""

    def __init__(self, moving: Bool[np.ndarray, " 52"]) -> None:
        self._free = ~moving[_COLUMNS]

    def init_state(self, rows: int) -> IdleState:
        """Nothing seen yet."""
        return IdleState(np.zeros(rows, np.int64), np.zeros((rows, 3)))

    def step(
        self,
        curves: Float[np.ndarray, "b t 52"],
        loudness: Float[np.ndarray, "b t"],
        state: IdleState,
        active: Bool[np.ndarray, " b"],
        seeds: Int[np.ndarray, " b"],
    ) -> Float[np.ndarray, "b t 52"]:
        """The curves with idle motion on the free channels; `loudness` is that of `frame_loudness`."""
        lively = curves.copy()
        for row in np.flatnonzero(active):
            seed, path, (fast, slow, brow) = int(seeds[row]), [], state.brows[row].tolist()
            for frame, now in enumerate(loudness[row].tolist(), int(state.seen[row])):
                fast += _FAST * (now - fast)
                slow += _SLOW * (now - slow)
                lift = min(max(4 * (fast - slow) - 0.3, 0.0), 1.0)
                brow += (_RISE if lift > brow else _FALL) * (lift - brow)
                lids, (yaw, pitch), lifted = blink(seed, frame), gaze(seed, frame), brow * brow_gate(seed, frame)
                drift = 0.03 * (1 + math.sin(frame * (2 * math.pi / 210) + seed % 97))
                looks = (yaw, yaw, -yaw, -yaw, pitch, pitch, -pitch, -pitch)
                path.append((lids, lids, *looks, 0.5 * lifted + drift, 0.4 * lifted, 0.36 * lifted))
            lively[row, :, _COLUMNS] += (np.maximum(path, 0) * self._free).T
            state.brows[row] = fast, slow, brow
        state.seen[active] += curves.shape[1]
        return np.asarray(lively.clip(0, 1))


def frame_loudness(audio: Float[np.ndarray, "b s"]) -> Float[np.ndarray, "b t"]:
    """Loudness of each motion frame, 0 (-60 dBFS and less) to 1 (full scale); double precision."""
    power = np.square(audio.reshape(len(audio), -1, SAMPLES_PER_FRAME), dtype=float).mean(2)
    return np.asarray(np.clip(1 - 10 * np.log10(power + 1e-12) / _FAINTEST_DB, 0, 1))


def blink(seed: int, frame: int) -> float:
    """Lids: 0 open, 1 shut."""
    place, is_there, is_double = _drawn(seed, 0, frame // _BLINK_EVERY, 3)
    last = len(_BLINK) - 1
    since = frame % _BLINK_EVERY - int(place * (_BLINK_EVERY - last + 1 - _DOUBLE_AFTER)) + 1
    if is_there >= _BLINKS:
        return 0.0
    again = since - _DOUBLE_AFTER if is_double < _DOUBLES else 0
    return max(_BLINK[min(max(each, 0), last)] for each in (since, again))


def gaze(seed: int, frame: int) -> tuple[float, float]:
    """Yaw (positive: to the character's left) and pitch (positive: up), in units of the look curves."""
    draw, into = divmod(frame, _GAZE_EVERY)
    before, here = _drawn(seed, 1, draw - 1, 4), _drawn(seed, 1, draw, 4)
    done = min(max((into - here[0] * (_GAZE_EVERY / 2)) / _GAZE_FRAMES, 0.0), 1.0)
    ends = [(0.0, 0.0) if home < _GAZE_HOME else (2 * yaw - 1, 2 * pitch - 1) for _, yaw, pitch, home in (before, here)]
    yaw, pitch = (old + done * (new - old) for old, new in zip(*ends, strict=True))
    return yaw * _GAZE_YAW, pitch * _GAZE_PITCH


def brow_gate(seed: int, frame: int) -> float:
    """How much the brows follow accents, changing smoothly between 0 and 1."""
    draw, into = divmod(frame, _BROW_GATE_EVERY)
    (here,), (after,) = _drawn(seed, 2, draw, 1), _drawn(seed, 2, draw + 1, 1)
    return here + into / _BROW_GATE_EVERY * (after - here)


@functools.lru_cache(4096)  # a session needs six at a time
def _drawn(seed: int, kind: int, draw: int, count: int) -> tuple[float, ...]:
    """`count` uniform numbers in (0, 1) of an interval (`draw`); `kind`: 0 blinks, 1 gaze, 2 brows."""
    key, start = np.array([(seed ^ _SALT) + kind]), np.array([draw])
    return tuple(uniform_noise(key, start, count=1, codes=count)[0, 0].tolist())
