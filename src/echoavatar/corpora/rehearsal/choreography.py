"""The motion for a whole sound track: gesture, dance and idle motion with transitions between them.

Dance starts shortly after the music and stops with it. Pose and velocity are continuous: the difference to the new
motion fades out along a quintic (inertialisation). Each foot moves to its new place in a step of its own, so planted
feet do not slide.
"""

from dataclasses import fields, replace

import numpy as np
from jaxtyping import Float

from echoavatar.corpora.capture.dances import captured_dance
from echoavatar.corpora.capture.library import CapturedLibrary
from echoavatar.timing import FRAME_RATE_HZ

from .clearance import keep_hands_clear
from .controls import ANKLE_HEIGHT, Array, Controls, fading, moved
from .dance import dance
from .gesture import gesture
from .sound import SoundTrack
from .stance import air

REACTION_S = 0.25  # from the start of music to the start of the dance
JOIN_S, SETTLE_S = 1.0, 0.85
STEP_S = 0.40
SHORTEST_DANCE_S = 1.5
CAPTURED_SHARE = 0.7  # of dances, if there is a library
_FEET = ("foot_position", "foot_yaw", "foot_pitch", "foot_roll")


def choreograph(track: SoundTrack, seed: int, library: CapturedLibrary | None = None) -> Controls:
    """Controls for a whole track; deterministic for a track and seed. Bodies are captured if there is a library."""
    motion = gesture(track, seed, library)
    spans = [s for s in track.spans if s.kind == "music" and s.end - s.start >= SHORTEST_DANCE_S]
    if spans:
        standing, by_rule = motion, dance(track, seed)
        rng = np.random.default_rng([seed, 11])
        for span in spans:
            begin = round((span.start + REACTION_S) * FRAME_RATE_HZ)
            end = min(round(span.end * FRAME_RATE_HZ), len(motion)) - 1
            dancing = by_rule
            if library is not None and rng.random() < CAPTURED_SHARE:
                beats = track.beats[(track.beats >= span.start) & (track.beats < span.end)]
                captured = captured_dance(library, beats, begin / FRAME_RATE_HZ, (end + 1) / FRAME_RATE_HZ, rng)
                dancing = by_rule if captured is None else _inserted(captured, standing, begin)
            dancing = _brought(dancing, standing, begin)
            motion = switched(motion, dancing, at=begin, seconds=JOIN_S)
            standing = _brought(standing, dancing, end)
            motion = switched(motion, standing, at=end, seconds=SETTLE_S)
    return keep_hands_clear(motion)


def _inserted(piece: Controls, around: Controls, begin: int) -> Controls:
    """The piece from frame `begin` on, as long as `around`; before it what its first speed comes from, then its end."""
    own = piece.packed()[: len(around) - begin]
    table = np.tile(2 * own[0] - own[1], (len(around), 1))
    table[begin : begin + len(own)] = own
    table[begin + len(own) :] = own[-1]
    return Controls.unpacked(table)


def _brought(controls: Controls, to: Controls, at: int) -> Controls:
    """`controls` moved on the floor so that at this frame it has the place and heading of `to`."""
    turn = float(to.pelvis_rotation[at, 0] - controls.pelvis_rotation[at, 0])
    placed = moved(moved(controls, -controls.pelvis_position[at, [0, 2]]), np.zeros(2), turn=turn)
    return moved(placed, to.pelvis_position[at, [0, 2]])


def _unwound(after: Controls, before: Controls, at: int) -> Controls:
    """`after` with its angles shifted by whole turns, so that none of them spins when `before` gives way to it."""
    curves = {}
    for name in ("pelvis_rotation", "foot_yaw", "elbow_swing", "palm"):
        old, new = getattr(before, name), getattr(after, name)
        curves[name] = (new + 2 * np.pi * np.round((old[at] - new[at]) / (2 * np.pi))).astype(np.float32)
    return replace(after, **curves)


def switched(before: Controls, after: Controls, *, at: int, seconds: float) -> Controls:
    """`before` until frame `at`, then `after`; position and velocity stay continuous over `seconds`."""
    frames = len(before)
    at = int(np.clip(at, 1, max(frames - 2, 1)))
    if frames < 4 or at >= frames - 2:
        return before
    after = _unwound(after, before, at)
    curves: dict[str, Array] = {}
    for field in fields(Controls):
        if field.name not in _FEET:
            old, new = getattr(before, field.name), getattr(after, field.name)
            curves[field.name] = _carried_over(old, new, at, seconds)
    moments = _step_moments(after, at)
    for name in _FEET:
        old, new = getattr(before, name), getattr(after, name)
        sides = [_carried_over(old[:, s], new[:, s], moments[s], STEP_S) for s in range(2)]
        curves[name] = np.stack(sides, axis=1)
    return replace(before, **_with_lift(curves, before, after, moments))


def _with_lift(curves: dict[str, Array], before: Controls, after: Controls, moments: list[int]) -> dict[str, Array]:
    """Lift each foot while it steps to its new place, higher for a longer step, never below the floor."""
    for side, first in enumerate(moments):
        if first >= len(before) - 1:
            continue
        last = min(first + round(STEP_S * FRAME_RATE_HZ), len(before) - 1)
        way = after.foot_position[last, side] - before.foot_position[first, side]
        turn = abs(float(after.foot_yaw[last, side] - before.foot_yaw[first, side]))
        far = float(np.hypot(way[0], way[2])) + 0.1 * turn
        if far < 1e-4:
            continue
        phase = (np.arange(len(before)) - first) / (STEP_S * FRAME_RATE_HZ)
        height = curves["foot_position"][:, side, 1] + (0.012 + min(0.25 * far, 0.06)) * air(phase)
        inside = (phase > 0) & (phase < 1)
        curves["foot_position"][:, side, 1] = np.where(inside, np.maximum(height, ANKLE_HEIGHT), height)
        curves["foot_pitch"][:, side] += min(0.9 * far, 0.25) * air(np.clip(phase / 0.7, 0, 1))
    return curves


def _step_moments(after: Controls, at: int) -> list[int]:
    """First frame of each foot's step: one after the other, if possible while the other foot is planted in `after`."""
    length, limit = round(STEP_S * FRAME_RATE_HZ), len(after)
    flying = after.foot_position[..., 1] > ANKLE_HEIGHT + 0.004

    def cost(side: int, first: int) -> float:
        return float(flying[first : min(first + length, limit), 1 - side].sum()) + 0.15 * (first - at)

    options: list[tuple[float, list[int]]] = []
    for lead in range(2):
        for wait in range(0, 10, 3):
            first = at + wait
            for gap in range(0, 7, 3):
                second = first + length + gap
                moments = [first, second] if lead == 0 else [second, first]
                options.append((cost(0, moments[0]) + cost(1, moments[1]), moments))
    return min(options, key=lambda option: option[0])[1]


def _carried_over(old: Float[Array, "t ..."], new: Float[Array, "t ..."], at: int, seconds: float) -> Array:
    """`old` until `at`, then `new` plus their difference, which fades out along a quintic."""
    out = new.copy()
    out[:at] = old[:at]
    if at >= len(old):
        return out
    place = old[at] - new[at]
    previous = max(at - 1, 0)
    speed = (old[at] - old[previous]) - (new[at] - new[previous])
    length = max(round(seconds * FRAME_RATE_HZ), 2)
    last = min(at + length, len(old))
    out[at:last] += fading(place, speed, length)[: last - at]
    return out
