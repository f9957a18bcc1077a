"""Procedural idle motion of the upper face: blinks, brow accents on loud syllables, small shifts of gaze.

Not in the paper, whose model was trained on captured faces that blink. Only channels that the face model does not move
are animated. Blinks and gaze depend on the session's seed and the frame number alone and go on in silence; the brows
also depend on the sound.
"""

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
_BLINK = np.array([0, 0.35, 0.9, 1.0, 0.8, 0.5, 0.25, 0.08, 0])  # lids, frame by frame
_BLINKS, _DOUBLES, _DOUBLE_AFTER = 0.85, 0.12, 9
_GAZE_EVERY = 45  # frames
_GAZE_HOME = 0.55  # share of the time with the gaze on the viewer
_GAZE_YAW, _GAZE_PITCH = 0.25, 0.14
_GAZE_FRAMES = 2.0  # of a saccade
_BROW_GATE_EVERY = 24
_FAST, _SLOW, _RISE, _FALL = 0.5, 0.04, 0.4, 0.1  # one-pole weights per frame
_FAINTEST_DB = -60.0


@dataclass
class IdleState(StreamState):
    """All zero: nothing was seen yet."""

    seen: Int[np.ndarray, " b"]  # frames
    brows: Float[np.ndarray, "b 3"]  # fast and slow means of the loudness, and how far the brows are up


class IdleFace:
    """Adds idle motion to curves. `moving` (52) is true for the channels that the face model moves itself."""

    def __init__(self, moving: Bool[np.ndarray, " 52"]) -> None:
        self._free = ~moving

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
        frame = state.seen[:, None] + np.arange(curves.shape[1])
        brow = self._brow(loudness, state, active) * brow_gate(seeds, frame)
        yaw, pitch = gaze(seeds, frame)
        lids = blinks(seeds, frame)
        drift = 0.03 * (1 + np.sin(frame * (2 * math.pi / 210) + seeds[:, None] % 97))
        life = {
            "eyeBlinkLeft": lids,
            "eyeBlinkRight": lids,
            "eyeLookOutLeft": yaw,
            "eyeLookInRight": yaw,
            "eyeLookInLeft": -yaw,
            "eyeLookOutRight": -yaw,
            "eyeLookUpLeft": pitch,
            "eyeLookUpRight": pitch,
            "eyeLookDownLeft": -pitch,
            "eyeLookDownRight": -pitch,
            "browInnerUp": 0.5 * brow + drift,
            "browOuterUpLeft": 0.4 * brow,
            "browOuterUpRight": 0.36 * brow,
        }
        added = np.zeros_like(curves)
        added[..., [ARKIT_NAMES.index(name) for name in life]] = np.maximum(np.stack([*life.values()], -1), 0)
        state.seen[active] += curves.shape[1]
        return np.asarray(np.clip(curves + added * self._free, 0, 1))

    def _brow(
        self, loudness: Float[np.ndarray, "b t"], state: IdleState, active: Bool[np.ndarray, " b"]
    ) -> Float[np.ndarray, "b t"]:
        """How far sudden loudness lifts the brows: quickly up, slowly down."""
        (fast, slow, brow), path = state.brows.T, []
        for now in loudness.T:
            fast = fast + _FAST * (now - fast)
            slow = slow + _SLOW * (now - slow)
            lift = np.clip(4 * (fast - slow) - 0.3, 0, 1)
            brow = brow + np.where(lift > brow, _RISE, _FALL) * (lift - brow)
            path.append(brow)
        state.brows[active] = np.stack([fast, slow, brow], 1)[active]
        return np.stack(path, 1)


def frame_loudness(audio: Float[np.ndarray, "b s"]) -> Float[np.ndarray, "b t"]:
    """Per motion frame, 0 (-60 dBFS and less) to 1 (full scale); double precision."""
    power = np.square(audio.reshape(len(audio), -1, SAMPLES_PER_FRAME), dtype=float).mean(2)
    return np.asarray(np.clip(1 - 10 * np.log10(power + 1e-12) / _FAINTEST_DB, 0, 1))


def blinks(seeds: Int[np.ndarray, " b"], frame: Int[np.ndarray, "b t"]) -> Float[np.ndarray, "b t"]:
    """Lids: 0 open, 1 shut."""
    (place, is_there, is_double), _ = _drawn(seeds, frame, every=_BLINK_EVERY, numbers=3, kind=0)
    last = len(_BLINK) - 1
    start = (place * (_BLINK_EVERY - last + 1 - _DOUBLE_AFTER)).astype(int)
    since = frame % _BLINK_EVERY - start + 1
    once, again = (_BLINK[np.clip(since - after, 0, last)] for after in (0, _DOUBLE_AFTER))
    return np.where(is_there < _BLINKS, np.maximum(once, np.where(is_double < _DOUBLES, again, 0)), 0)


def gaze(
    seeds: Int[np.ndarray, " b"], frame: Int[np.ndarray, "b t"]
) -> tuple[Float[np.ndarray, "b t"], Float[np.ndarray, "b t"]]:
    """Yaw (positive: to the character's left) and pitch (positive: up), in units of the look curves."""
    before, here = _drawn(seeds, frame - _GAZE_EVERY, every=_GAZE_EVERY, numbers=4, kind=1)
    done = np.clip((frame % _GAZE_EVERY - here[0] * (_GAZE_EVERY / 2)) / _GAZE_FRAMES, 0, 1)
    most = np.array([_GAZE_YAW, _GAZE_PITCH])[:, None, None]
    old, new = (np.where(draw[3] < _GAZE_HOME, 0, (2 * draw[1:3] - 1) * most) for draw in (before, here))
    yaw, pitch = old + done * (new - old)
    return yaw, pitch


def brow_gate(seeds: Int[np.ndarray, " b"], frame: Int[np.ndarray, "b t"]) -> Float[np.ndarray, "b t"]:
    """How much the brows follow accents, changing smoothly between 0 and 1."""
    (here,), (after,) = _drawn(seeds, frame, every=_BROW_GATE_EVERY, numbers=1, kind=2)
    return np.asarray(here + frame % _BROW_GATE_EVERY / _BROW_GATE_EVERY * (after - here))


def _drawn(
    seeds: Int[np.ndarray, " b"], frame: Int[np.ndarray, "b t"], *, every: int, numbers: int, kind: int
) -> tuple[Float[np.ndarray, "n b t"], Float[np.ndarray, "n b t"]]:
    """Uniform numbers, constant over every `every` frames: of each frame, and those that follow them."""
    first = frame[:, 0] // every
    draws = uniform_noise((seeds ^ _SALT) + kind, first, count=frame.shape[1] // every + 3, codes=numbers)
    row, place = np.arange(len(seeds))[:, None], frame // every - first[:, None]
    return np.moveaxis(draws[row, place], 2, 0), np.moveaxis(draws[row, place + 1], 2, 0)
