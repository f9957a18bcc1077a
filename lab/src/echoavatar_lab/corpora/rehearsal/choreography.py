"""The motion for a whole sound track: gesture, dance and idle motion with transitions between them.

Dance starts shortly after the music and stops with it. Pose and velocity are continuous: the difference to the new
motion fades out along a quintic (inertialisation). Each foot moves to its new place in a step of its own, so planted
feet do not slide.
"""

from dataclasses import fields, replace

import numpy as np
from jaxtyping import Float

from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.capture.library import CapturedLibrary

from ..controls import (
    ANKLE_HEIGHT,
    DRIFT_FRAMES,
    FEET,
    Array,
    Controls,
    air,
    fading,
    minimum_jerk,
    moved,
    turned,
    unwound,
    wrists_over,
)
from ..dance.captured_dance import dance_to
from ..dance.grooves import find_counts
from ..dance.roaming import ASIDE_BY_RULE_M, ASIDE_CAPTURED_M, with_travel
from ..gesture.gesture import gesture
from ..sound import SoundTrack
from .clearance import keep_hands_clear

REACTION_S = 0.25  # from the start of music to the start of the dance
JOIN_S, SETTLE_S = 1.0, 0.85
STEP_S = 0.40
LANDING_FRAMES = 6
SHORTEST_DANCE_S = 1.5
NEAR_M, STRIDE_M = 0.12, 0.25  # a dancer who ends nearer to the place of the standing body walks nowhere


def choreograph(track: SoundTrack, seed: int, library: CapturedLibrary | None = None) -> Controls:
    """Controls for a whole track; deterministic for a track and seed. Bodies are captured if there is a library."""
    motion = gesture(track, seed, library)
    spans = [s for s in track.spans if s.kind == "music" and s.end - s.start >= SHORTEST_DANCE_S]
    if spans:
        standing, dancing = motion, dance_to(track, seed, library)
        aside = ASIDE_BY_RULE_M if library is None else ASIDE_CAPTURED_M
        for number, span in enumerate(spans):
            begin = round((span.start + REACTION_S) * FRAME_RATE_HZ)
            end = min(round(span.end * FRAME_RATE_HZ), len(motion)) - 1
            dancing = _brought(dancing, motion, begin)  # the dancer may still be on the way home
            rng = np.random.default_rng([seed, 10, number])
            dancing = with_travel(dancing, find_counts(track, span), standing, rng, aside)
            motion = switched(motion, dancing, at=begin, seconds=JOIN_S)
            motion = switched(motion, walking_home(standing, motion, end), at=end, seconds=SETTLE_S)
    return keep_hands_clear(motion)


def _brought(controls: Controls, to: Controls, at: int) -> Controls:
    """`controls` moved on the floor so that at this frame it has the place and heading of `to`."""
    turn = float(to.pelvis_rotation[at, 0] - controls.pelvis_rotation[at, 0])
    centred = moved(controls, -controls.pelvis_position[at, [0, 2]])
    return moved(centred, to.pelvis_position[at, [0, 2]], turn=turn)


def switched(before: Controls, after: Controls, *, at: int, seconds: float) -> Controls:
    """`before` until frame `at`, then `after`; position and velocity stay continuous over `seconds`."""
    frames = len(before)
    at = int(np.clip(at, 1, max(frames - 2, 1)))
    if frames < 4 or at >= frames - 2:
        return before
    after = unwound(after, before, at, at)
    curves: dict[str, Array] = {}
    for field in fields(Controls):
        if field.name not in (*FEET, "wrist"):
            old, new = getattr(before, field.name), getattr(after, field.name)
            drift = DRIFT_FRAMES if field.name in ("palm", "elbow_swing") else None
            if field.name.startswith("pelvis"):  # hips that lag behind their feet longer get out of the legs' reach
                drift = round(STEP_S * FRAME_RATE_HZ)
            curves[field.name] = _carried_over(old, new, at, seconds, drift=drift)
    over = wrists_over(before.wrist[at - 1 : at + 1], after.wrist[at - 1 :], round(seconds * FRAME_RATE_HZ))
    curves["wrist"] = np.concatenate([before.wrist[:at], over])
    moments = _step_moments(before, after, at)
    waiting = _landed(before, at)
    for name in FEET:
        old, new = getattr(waiting, name), getattr(after, name)
        turn = 2 * np.pi if name == "foot_yaw" else np.inf
        sides = [_carried_over(old[:, s], new[:, s], moments[s], STEP_S, turn, LANDING_FRAMES) for s in range(2)]
        curves[name] = np.stack(sides, axis=1)
    return replace(before, **_with_lift(curves, waiting, after, moments))


def _landed(before: Controls, at: int) -> Controls:
    """`before` with feet that come down where they are at frame `at`, and wait there for their step."""
    curves, left = {}, 1 - minimum_jerk(np.arange(len(before) - at) / LANDING_FRAMES)
    for name in FEET:
        old = getattr(before, name)
        new = old.copy()
        speed, left_frames = old[at] - old[max(at - 1, 0)], len(before) - at
        drift = fading(np.zeros_like(speed), speed, left_frames, left_frames, drift=LANDING_FRAMES)
        new[at:] = old[at] + drift
        if name == "foot_position":
            height = new[at:, :, 1]
            new[at:, :, 1] = np.maximum(ANKLE_HEIGHT + left[:, None] * (height - ANKLE_HEIGHT), ANKLE_HEIGHT)
        elif name != "foot_yaw":
            new[at:] *= left[:, None]
        curves[name] = new
    return replace(before, **curves)


def walking_home(standing: Controls, before: Controls, at: int) -> Controls:
    """`standing`, begun at frame `at` where the dancer is, and brought to its own place by steps."""
    standing = unwound(standing, before, at, at)
    off = (before.pelvis_position[at] - standing.pelvis_position[at])[[0, 2]]
    turn = float(before.pelvis_rotation[at, 0] - standing.pelvis_rotation[at, 0])
    far = float(np.hypot(*off)) + 0.35 * abs(turn)
    if far < NEAR_M:
        return standing
    stride = round((STEP_S + 0.04) * FRAME_RATE_HZ)
    begin, steps = at + 2 * stride, max(2, int(np.ceil(far / STRIDE_M)) + 1)
    left = 1 - minimum_jerk((np.arange(len(standing)) - begin) / (steps * stride))
    middle = standing.pelvis_position[at, [0, 2]]
    curves = {name: getattr(standing, name).copy() for name in FEET}
    place = _carried(standing.pelvis_position, middle, off * left[:, None], turn * left)
    rotation = standing.pelvis_rotation.copy()
    rotation[:, 0] += (turn * left).astype(np.float32)
    for side in range(2):
        share = np.ones(len(standing))
        for number in range(steps + 1):
            if number % 2 != side:
                continue
            first = begin + number * stride - stride // 2
            goal = left[min(first + stride, len(left) - 1)] if number < steps - 1 else 0.0
            phase = (np.arange(len(standing)) - first) / stride
            share += (goal - share) * minimum_jerk((phase - 0.18) / 0.66)
            curves["foot_position"][:, side, 1] += 0.055 * air(phase)
            curves["foot_pitch"][:, side] += 0.2 * air(np.clip(phase / 0.7, 0, 1))
        foot = _carried(curves["foot_position"][:, side], middle, off * share[:, None], turn * share)
        curves["foot_position"][:, side] = foot
        curves["foot_yaw"][:, side] += (turn * share).astype(np.float32)
    return replace(standing, pelvis_position=place, pelvis_rotation=rotation, **curves)


def _carried(
    place: Float[Array, "t 3"], middle: Float[Array, " 2"], shift: Float[Array, "t 2"], turn: Float[Array, " t"]
) -> Array:
    """Places turned about a middle and shifted, frame by frame."""
    out = place.copy()
    out[:, [0, 2]] = middle + turned(place[:, [0, 2]] - middle, turn) + shift
    return out


def _with_lift(curves: dict[str, Array], before: Controls, after: Controls, moments: list[int]) -> dict[str, Array]:
    """Lift each foot while it steps to its new place, higher for a longer step, never below the floor."""
    for side, first in enumerate(moments):
        if first >= len(before) - 1:
            continue
        last = min(first + round(STEP_S * FRAME_RATE_HZ), len(before) - 1)
        way = after.foot_position[last, side] - before.foot_position[first, side]
        turn = abs(float(np.arcsin(np.sin((after.foot_yaw[last, side] - before.foot_yaw[first, side]) / 2))) * 2)
        far = float(np.hypot(way[0], way[2])) + 0.1 * turn
        if far < 1e-4:
            continue
        phase = (np.arange(len(before)) - first) / (STEP_S * FRAME_RATE_HZ)
        height = curves["foot_position"][:, side, 1] + (0.012 + min(0.25 * far, 0.06)) * air(phase)
        inside = (phase > 0) & (phase < 1)
        curves["foot_position"][:, side, 1] = np.where(inside, np.maximum(height, ANKLE_HEIGHT), height)
        curves["foot_pitch"][:, side] += min(0.9 * far, 0.25) * air(np.clip(phase / 0.7, 0, 1))
    return curves


def _step_moments(before: Controls, after: Controls, at: int) -> list[int]:
    """First frame of each foot's step: one after the other, if possible while the other foot is planted in `after`.

    A foot that is in the air steps first.
    """
    length, limit = round(STEP_S * FRAME_RATE_HZ), len(after)
    flying = after.foot_position[..., 1] > ANKLE_HEIGHT + 0.004
    up = 1e3 * np.maximum(before.foot_position[at, :, 1] - ANKLE_HEIGHT - 0.004, 0)

    def cost(side: int, first: int) -> float:
        return float(flying[first : min(first + length, limit), 1 - side].sum()) + 0.15 * (first - at)

    options: list[tuple[float, list[int]]] = []
    for lead in range(2):
        for wait in range(0, 10, 3):
            first = at + wait
            for gap in range(0, 7, 3):
                second = first + length + gap
                moments = [first, second] if lead == 0 else [second, first]
                options.append((cost(0, moments[0]) + cost(1, moments[1]) + float(up[1 - lead]), moments))
    return min(options, key=lambda option: option[0])[1]


def _carried_over(
    old: Float[Array, "t ..."],
    new: Float[Array, "t ..."],
    at: int,
    seconds: float,
    turn: float = np.inf,
    drift: int | None = None,
) -> Array:
    """`old` until `at`, then `new` plus their difference but for whole turns, which fades out along a quintic."""
    out = new.copy()
    out[:at] = old[:at]
    if at >= len(old):
        return out
    place = old[at] - new[at]
    place = place - (turn * np.round(place / turn) if np.isfinite(turn) else 0.0)
    previous = max(at - 1, 0)
    speed = (old[at] - old[previous]) - (new[at] - new[previous])
    length = max(round(seconds * FRAME_RATE_HZ), 2)
    out[at:] += fading(place, speed, length, len(out) - at, drift=drift)
    return out
