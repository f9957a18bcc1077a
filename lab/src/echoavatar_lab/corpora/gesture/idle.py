"""Motion in silence and while listening: breath, slow weight shifts, head movement, hands at rest.

Gestures are added to this motion, so breath and stance continue through speech. With a captured library the body is a
captured person's: one who waits, arms included, and one who talks while there is speech, with the arms at rest.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from echoavatar.models.generator.manner import Manner, draw_manner
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.capture.library import CapturedLibrary
from echoavatar_lab.corpora.capture.motion_graph import IDLE, TALKING, standing_graph, walk

from ..controls import HANGING_WRIST, STANDING_PELVIS, Array, Controls, critically_damped, smoothed, wander
from ..sound import SoundTrack, bridged
from .handpath import FINGERS, pack_hand
from .handshapes import hand_shape
from .speakers import resting_of
from .stance import stances, walked, weight_curve

REACTION_S, ARMS_S = 0.15, 0.4  # from the sound to the body's answer; for the arms to come to rest
BREATH_HZ = 0.21, 0.30
PAUSE_S = 3.0  # the body of a speaker goes on through shorter pauses


def resting_hands(rest: str) -> Float[Array, "2 14"]:
    """Both hands at rest: hanging, clasped in front of the belly, one on the hip or both behind the back."""
    hanging = pack_hand(HANGING_WRIST, (0.08, 0.0, 0.35), hand_shape("relaxed"))
    if rest == "clasped":
        left = pack_hand((-0.095, -0.385, 0.190), (0.10, 0.05, 0.45), hand_shape("clasp"), 0.10)
        right = pack_hand((-0.095, -0.405, 0.235), (0.15, 0.05, 0.40), hand_shape("clasp"), 0.10)
        return np.stack([left, right])
    if rest == "hips":
        hips = pack_hand((0.065, -0.390, 0.075), (0.45, 0.05, 0.75), hand_shape("loose fist"), 0.55)
        return np.stack([hips, hanging])
    if rest == "behind":
        hand = pack_hand((0.015, -0.455, -0.080), (0.10, 0.0, 0.20), hand_shape("relaxed"), 0.15)
        return np.stack([hand, hand])
    return np.stack([hanging, hanging])


def idle(
    track: SoundTrack, seed: int, library: CapturedLibrary | None = None, manner: Manner | None = None
) -> Controls:
    """Standing, breathing and listening for the whole track; the `manner` is the seed's if there is none."""
    manner = manner or draw_manner(seed)
    if library is not None and library.of("standing"):
        return _captured(track, seed, library, manner)
    frames, rng = round(track.seconds * FRAME_RATE_HZ), np.random.default_rng([seed, 2])
    start = float(rng.choice([-0.5, 0.5]))
    steps, shifts = stances(track.seconds, track.phrases, rng, manner, start)
    body = standing(walked(frames, steps), weight_curve(frames, shifts, start), rng)
    breath = breathing(frames, float(rng.uniform(*BREATH_HZ)), rng)
    head = body.head + glances(track, rng) + wander(frames, 3, period=2.2, rng=rng) * (0.012, 0.010, 0.008)
    hands = np.repeat(resting_hands(resting_of(manner))[None], frames, axis=0)
    hands[:, :, :3] += wander(frames, 6, period=3.5, rng=rng).reshape(frames, 2, 3) * 0.003
    hands[:, :, FINGERS] += finger_drift(frames, rng) * 0.5
    spine = body.spine + wander(frames, 3, period=4.0, rng=rng) * (0.010, 0.006, 0.006)
    spine[:, 1] -= 0.012 * breath
    shoulder = body.shoulder + 0.022 * breath[:, None, None] * np.array([1.0, -0.4])
    head[:, 1] += 0.009 * breath
    return with_hands(replace(body, head=_f32(head), spine=_f32(spine), shoulder=_f32(shoulder)), hands)


def _captured(track: SoundTrack, seed: int, library: CapturedLibrary, manner: Manner) -> Controls:
    """A captured person who waits, and sways like people who talk from shortly after speech begins until it ends."""
    frames, rng = round(track.seconds * FRAME_RATE_HZ), np.random.default_rng([seed, 4])
    wanted, resting = np.full(frames, IDLE), np.zeros(frames, np.float32)
    for begin, end in bridged(track.phrases, PAUSE_S):
        first, last = (round((time + REACTION_S) * FRAME_RATE_HZ) for time in (begin, end))
        wanted[first:last] = TALKING * rng.uniform(0.8, 1.2) * (0.95 + 0.6 * manner.liveliness)
        resting[first:last] = 1.0
    body = walk(standing_graph(library), wanted, rng)
    share = critically_damped(resting, ARMS_S)[:, None, None]
    captured, rest = body.hands(), resting_hands(resting_of(manner))
    hands = captured + share * (rest - captured)
    hands[:, :, FINGERS] += finger_drift(frames, rng) * 0.5
    breath = breathing(frames, float(rng.uniform(*BREATH_HZ)), rng)
    spine, shoulder = body.spine.copy(), body.shoulder * (1 - share)
    spine[:, 1] -= 0.012 * breath
    shoulder += 0.022 * breath[:, None, None] * np.array([1.0, -0.4])
    return with_hands(replace(body, spine=_f32(spine), shoulder=_f32(shoulder)), hands)


def with_hands(body: Controls, hands: Float[Array, "t 2 14"]) -> Controls:
    """The same motion with other hands, as `Controls.hands` gives them."""
    return replace(
        body,
        wrist=_f32(hands[..., 0:3]),
        palm=_f32(hands[..., 3:6]),
        elbow_swing=_f32(hands[..., 6]),
        fingers=_f32(hands[..., 7:14]),
    )


def standing(base: Controls, weight: Float[Array, " t"], rng: np.random.Generator) -> Controls:
    """Pelvis and spine over the feet of a body; `weight` is -1 on the right leg, +1 on the left."""
    middle = smoothed(base.foot_position.mean(axis=1), 0.25)
    across = smoothed(base.foot_position[:, 0] - base.foot_position[:, 1], 0.25)
    sway = wander(len(base), 2, period=2.5, rng=rng) * (0.004, 0.003)
    pelvis = base.pelvis_position.copy()
    pelvis[:, 0] = middle[:, 0] + across[:, 0] * 0.36 * weight + sway[:, 0]
    pelvis[:, 2] = middle[:, 2] + 0.015 + across[:, 2] * 0.36 * weight + sway[:, 1]
    pelvis[:, 1] = STANDING_PELVIS[1] - 0.006 * weight**2
    heading = smoothed(base.foot_yaw.mean(axis=1), 0.3)
    rotation = base.pelvis_rotation.copy()
    rotation[:, 0] = heading * 0.7 - 0.05 * weight
    rotation[:, 2] = 0.045 * weight
    spine, head = base.spine.copy(), base.head.copy()
    spine[:, 0] += 0.04 * weight
    spine[:, 2] -= 0.055 * weight
    head[:, 2] += 0.012 * weight
    return replace(
        base, pelvis_position=_f32(pelvis), pelvis_rotation=_f32(rotation), spine=_f32(spine), head=_f32(head)
    )


def breathing(frames: int, rate_hz: float, rng: np.random.Generator) -> Float[Array, " t"]:
    """A slightly irregular breath curve around zero, which rises in about two fifths of each cycle."""
    rate = rate_hz * (1 + 0.12 * wander(frames, 1, period=9.0, rng=rng)[:, 0])
    phase = 2 * np.pi * (rng.random() + np.cumsum(rate) / FRAME_RATE_HZ)
    return np.asarray(np.sin(phase + 0.35 * np.sin(phase)), np.float32)


def finger_drift(frames: int, rng: np.random.Generator) -> Float[Array, "t 2 7"]:
    """Small slow finger motion, partly shared by all fingers of a hand."""
    one = wander(frames, 14, period=1.6, rng=rng).reshape(frames, 2, 7)
    together = wander(frames, 2, period=2.6, rng=rng)[..., None]
    scale = np.array([0.025, 0.035, 0.035, 0.035, 0.035, 0.05, 0.04], np.float32)
    return np.asarray((0.6 * one + 0.7 * together) * scale, np.float32)


def glances(track: SoundTrack, rng: np.random.Generator) -> Float[Array, "t 3"]:
    """Head turns to a new direction every few seconds, larger in silence than otherwise."""
    frames = round(track.seconds * FRAME_RATE_HZ)
    quiet = [(span.start, span.end) for span in track.spans if span.kind == "silence"]
    steps = np.zeros((frames + 1, 3))
    time, last = 1.0, np.zeros(3)
    while time < track.seconds:
        is_quiet = any(begin + 1 < time < end for begin, end in quiet)
        goal = rng.normal(0.0, 1.0, 3) * ((0.13, 0.035, 0.03) if is_quiet else (0.05, 0.02, 0.02))
        goal = np.clip(goal, -0.22, 0.22)
        steps[int(time * FRAME_RATE_HZ)] = goal - last
        last = goal
        time += rng.uniform(2.2, 5.0)
    return smoothed(steps.cumsum(axis=0)[:-1].astype(np.float32), 0.17)


def _f32(array: Float[Array, "..."]) -> Array:
    return np.asarray(array, np.float32)
