"""Procedural idle motion of the upper face: blinks, brow accents on loud syllables, small shifts of gaze.

Not in the paper, whose model was trained on captured faces that blink. Only channels that the face model does not move
are animated. Blinks and gaze depend on the session's seed and the frame number alone and go on in silence; the brows
also depend on the sound.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.nn import StreamState, write_rows
from echoavatar.timing import SAMPLES_PER_FRAME

from ..generator.sampling import uniform_noise

_SALT = 0x69646C652D666163  # so that the noise differs from the flow head's
_BLINK_EVERY = 100  # frames (3.3 s); each holds one blink; some are left out, some are double
_BLINK = (0.35, 0.9, 1.0, 0.8, 0.5, 0.25, 0.08)  # lids, frame by frame
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

    seen: Int[Tensor, " b"]  # frames
    fast: Float[Tensor, " b"]
    slow: Float[Tensor, " b"]
    brow: Float[Tensor, " b"]


class IdleFace:
    """Adds idle motion to curves. `moving` (52) is 1 for the channels that the face model moves itself."""

    def __init__(self, moving: Float[Tensor, " 52"]) -> None:
        self._free = 1 - moving.double()

    def init_state(self, rows: int) -> IdleState:
        """Nothing seen yet."""
        level = self._free.new_zeros(rows)
        return IdleState(level.long(), level, level.clone(), level.clone())

    @torch.no_grad()
    def step(
        self,
        curves: Float[Tensor, "b t 52"],
        loudness: Float[Tensor, "b t"],
        state: IdleState,
        active: Bool[Tensor, " b"],
        seeds: Int[Tensor, " b"],
    ) -> Float[Tensor, "b t 52"]:
        """The curves with idle motion on the free channels; `loudness` is that of `frame_loudness`."""
        frame = state.seen[:, None] + torch.arange(curves.shape[1], device=curves.device)
        brow = self._brow(loudness.double(), state, active) * brow_gate(seeds, frame)
        yaw, pitch = gaze(seeds, frame)
        lids = blinks(seeds, frame)
        drift = 0.03 * (1 + torch.sin(frame * (2 * math.pi / 210) + seeds[:, None] % 97))
        life = {
            "eyeBlinkLeft": lids,
            "eyeBlinkRight": lids,
            "eyeLookOutLeft": yaw.clamp_min(0),
            "eyeLookInRight": yaw.clamp_min(0),
            "eyeLookInLeft": (-yaw).clamp_min(0),
            "eyeLookOutRight": (-yaw).clamp_min(0),
            "eyeLookUpLeft": pitch.clamp_min(0),
            "eyeLookUpRight": pitch.clamp_min(0),
            "eyeLookDownLeft": (-pitch).clamp_min(0),
            "eyeLookDownRight": (-pitch).clamp_min(0),
            "browInnerUp": 0.5 * brow + drift,
            "browOuterUpLeft": 0.4 * brow,
            "browOuterUpRight": 0.36 * brow,
        }
        added = torch.zeros_like(curves, dtype=torch.float64)
        for name, value in life.items():
            added[..., ARKIT_NAMES.index(name)] = value
        write_rows(state.seen, state.seen + curves.shape[1], active)
        return (curves + (added * self._free).to(curves)).clamp(0, 1)

    def _brow(
        self, loudness: Float[Tensor, "b t"], state: IdleState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b t"]:
        """How far sudden loudness lifts the brows: quickly up, slowly down."""
        fast, slow, brow, path = state.fast, state.slow, state.brow, []
        for now in loudness.unbind(1):
            fast = fast + _FAST * (now - fast)
            slow = slow + _SLOW * (now - slow)
            lift = (4 * (fast - slow) - 0.3).clamp(0, 1)
            brow = brow + torch.where(lift > brow, _RISE, _FALL) * (lift - brow)
            path.append(brow)
        for kept, value in ((state.fast, fast), (state.slow, slow), (state.brow, brow)):
            write_rows(kept, value, active)
        return torch.stack(path, 1)


def frame_loudness(audio: Float[Tensor, "b s"]) -> Float[Tensor, "b t"]:
    """Per motion frame, 0 (-60 dBFS and less) to 1 (full scale)."""
    power = audio.unflatten(1, (-1, SAMPLES_PER_FRAME)).square().mean(2)  # type: ignore[no-untyped-call]
    return (1 - 10 * torch.log10(power + 1e-12) / _FAINTEST_DB).clamp(0, 1)


def blinks(seeds: Int[Tensor, " b"], frame: Int[Tensor, "b t"]) -> Float[Tensor, "b t"]:
    """Lids: 0 open, 1 shut."""
    place, is_there, is_double = _drawn(seeds, frame, every=_BLINK_EVERY, numbers=3, kind=0).unbind(-1)
    longest = len(_BLINK) + _DOUBLE_AFTER
    start = (place * (_BLINK_EVERY - longest)).long()
    shape = F.pad(torch.tensor(_BLINK, dtype=torch.float64, device=frame.device), (1, 1))
    since = frame % _BLINK_EVERY - start

    def lids(after: int) -> Tensor:
        return shape[(since - after + 1).clamp(0, len(_BLINK) + 1)]

    again = torch.where(is_double < _DOUBLES, lids(_DOUBLE_AFTER), 0.0)
    return torch.where(is_there < _BLINKS, torch.maximum(lids(0), again), 0.0)


def gaze(seeds: Int[Tensor, " b"], frame: Int[Tensor, "b t"]) -> tuple[Float[Tensor, "b t"], Float[Tensor, "b t"]]:
    """Yaw (positive: to the character's left) and pitch (positive: up), in units of the look curves."""
    here = _drawn(seeds, frame, every=_GAZE_EVERY, numbers=4, kind=1)
    before = _drawn(seeds, frame - _GAZE_EVERY, every=_GAZE_EVERY, numbers=4, kind=1)
    jump = here[..., 0] * (_GAZE_EVERY / 2)
    done = ((frame % _GAZE_EVERY - jump) / _GAZE_FRAMES).clamp(0, 1)
    sides = []
    for axis, most in ((1, _GAZE_YAW), (2, _GAZE_PITCH)):
        old, new = (
            torch.where(draw[..., 3] < _GAZE_HOME, 0.0, (2 * draw[..., axis] - 1) * most) for draw in (before, here)
        )
        sides.append(torch.lerp(old, new, done))
    return sides[0], sides[1]


def brow_gate(seeds: Int[Tensor, " b"], frame: Int[Tensor, "b t"]) -> Float[Tensor, "b t"]:
    """How much the brows follow accents, changing smoothly between 0 and 1."""
    here = _drawn(seeds, frame, every=_BROW_GATE_EVERY, numbers=1, kind=2)[..., 0]
    after = _drawn(seeds, frame + _BROW_GATE_EVERY, every=_BROW_GATE_EVERY, numbers=1, kind=2)[..., 0]
    return torch.lerp(here, after, (frame % _BROW_GATE_EVERY).double() / _BROW_GATE_EVERY)


def _drawn(
    seeds: Int[Tensor, " b"], frame: Int[Tensor, "b t"], *, every: int, numbers: int, kind: int
) -> Float[Tensor, "b t n"]:
    """Uniform numbers, constant over every `every` frames."""
    first = torch.div(frame[:, 0], every, rounding_mode="floor")
    count = frame.shape[1] // every + 2
    draws = uniform_noise((seeds ^ _SALT) + kind, first, count=count, codes=numbers)
    place = torch.div(frame, every, rounding_mode="floor") - first[:, None]
    return draws.gather(1, place[..., None].expand(-1, -1, numbers))
