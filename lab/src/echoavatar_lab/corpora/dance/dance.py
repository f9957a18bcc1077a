"""Dance to labelled music: full-body curves locked to counts, starting and ending in a standing pose.

The paper trains on recorded dance. Here feet follow planned footholds, the pelvis stays over the supporting foot, the
chest turns against the hips, arm poses arrive on counts and the head faces the front. Outside music the dancer stands.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from echoavatar.timing import FRAME_RATE_HZ

from ..controls import STANDING_PELVIS, Array, Controls, air, minimum_jerk, neutral, smoothed
from ..keyframes import gaps, glide, progress
from ..sound import SoundTrack, Span
from .dance_plan import BodyKey, DancePlan, compose_dance
from .footwork import Footwork, walk
from .grooves import find_counts

ARM = 16  # values of one arm in a body vector
LEG, HIP_OUT, HIP_DOWN = 0.808, 0.092, 0.035  # metres: comfortable leg length, offset of the hip joints
FASTEST_ARM = 8.0  # radians per second, at the peak of a glide
FASTEST_WRIST = 2.2  # metres per second, at the peak of a glide
HIPS_WITH_WEIGHT, SHOULDERS_WITH_WEIGHT = 1.0, 3.8  # turns against the roll of the hips: contrapposto
LINGER, LINGER_HALF_TIME = 0.25, 0.55  # share by which the dancer's clock slows down on a beat
ANSWER_S = 0.06  # delay after the music's beat, so that moves decelerate on it, which the metric BA_D looks for
REST_SECONDS = 0.9  # time in which the arms sink when the music stops


def danced(track: SoundTrack) -> list[Span]:
    """The spans of a track that are long enough to dance to."""
    return [span for span in track.spans if span.kind == "music" and span.end - span.start > 0.5]


def dance(track: SoundTrack, seed: int) -> Controls:
    """Dance in the music spans of a track and stand at ease elsewhere; deterministic for a seed."""
    plans = [
        compose_dance(find_counts(track, span), np.random.default_rng([seed, 7, number]))
        for number, span in enumerate(danced(track))
    ]
    frames = round(track.seconds * FRAME_RATE_HZ)
    t = np.arange(frames) / FRAME_RATE_HZ - ANSWER_S
    felt = _dancer_clock(t, plans)
    holds, shifts = ([key for plan in plans for key in getattr(plan, name)] for name in ("holds", "shifts"))
    feet = walk(felt, holds, shifts)
    body = _body(felt, plans)
    beat, level = _pulse(t, plans)
    base = neutral(frames)
    pelvis, turn = _pelvis(felt, plans, feet, beat, level)
    sway = _groove(felt, plans, "hips") * level[:, 1] * (2 * feet.share - 1)
    turn[:, 0] -= HIPS_WITH_WEIGHT * sway
    chest, head = _torso(plans, body, turn, beat, level)
    chest[:, 0] += SHOULDERS_WITH_WEIGHT * sway
    arms = body[:, : 2 * ARM].reshape(frames, 2, ARM)
    curves = {
        "pelvis_position": pelvis,
        "pelvis_rotation": turn + base.pelvis_rotation,
        "spine": chest + base.spine,
        "head": head + base.head,
        "foot_position": feet.position,
        "foot_yaw": feet.yaw,
        "foot_pitch": feet.pitch,
        "shoulder": arms[..., 7:9] + 0.03 * (beat * level[:, 0])[:, None, None] * np.array([1.0, 0.0]),
        "wrist": arms[..., 0:3],
        "palm": _follow_through(arms),
        "elbow_swing": arms[..., 6],
        "fingers": _soft(arms[..., 9:16], 0.05),
    }
    return replace(base, **{name: curve.astype(np.float32) for name, curve in curves.items()})


def _dancer_clock(t: Array, plans: list[DancePlan]) -> Array:
    """The dancer's clock: it slows down at every beat, also between counts, and agrees with real time on beats."""
    result = t.copy()
    for plan in plans:
        counts = plan.counts
        first, last = np.searchsorted(t, [plan.begin, plan.settle + 0.3])
        own = t[first:last]
        beat = _count(own, counts.times) * counts.unit
        length = float(np.median(np.diff(counts.times))) / counts.unit
        ease = minimum_jerk((own - plan.begin) / 1.0) * minimum_jerk((plan.settle + 0.3 - own) / 0.5)
        linger = LINGER_HALF_TIME if counts.unit > 1 else LINGER
        result[first:last] -= ease * linger * length / (2 * np.pi) * np.sin(2 * np.pi * beat)
    return result


def _pelvis(t: Array, plans: list[DancePlan], feet: Footwork, beat: Array, level: Array) -> tuple[Array, Array]:
    """Position over the supporting foot, and rotation (yaw, pitch, roll)."""
    share = 0.5 + 0.86 * (feet.share - 0.5)
    over = feet.position[:, 0] * share[:, None] + feet.position[:, 1] * (1 - share)[:, None]
    over = _soft(over, 0.06)
    bounce, hips = level[:, 0], level[:, 1]
    crouch, lean, roll = (_groove(t, plans, name) for name in ("crouch", "lean", "hips"))
    dip = _keyed(t, plans, "dip")
    low = crouch + dip + bounce * beat
    low += level[:, 2] * _eased_down(feet, over, STANDING_PELVIS[1] - low)
    position = np.stack([over[:, 0], STANDING_PELVIS[1] - low, over[:, 2] + 0.015 - 0.35 * low], 1)
    yaw = _soft(feet.yaw.mean(1), 0.10) + _keyed(t, plans, "twist")
    return position, np.stack([yaw, lean + 0.9 * low, roll * hips * (2 * feet.share - 1)], 1)


def _eased_down(feet: Footwork, over: Array, height: Array) -> Array:
    """How far the pelvis must sink for both legs to reach; smoothed over time, so that it sinks gently."""
    lack = np.zeros(len(over))
    for side in (0, 1):
        outwards = HIP_OUT if side == 0 else -HIP_OUT
        away = feet.position[:, side] - over
        heel = np.maximum(feet.pitch[:, side], 0.0)
        flat = np.maximum(np.hypot(away[:, 0] - outwards, away[:, 2] - 0.015) - 0.06 * heel, 0.0)
        ceiling = feet.position[:, side, 1] + 0.12 * heel + np.sqrt(LEG**2 - np.minimum(flat, 0.6) ** 2) + HIP_DOWN
        lack = np.maximum(lack, height - ceiling)
    lack = maximum_filter1d(np.maximum(lack, 0.0), 7, mode="nearest")
    return _soft(lack, 0.07)


def _torso(plans: list[DancePlan], body: Array, turn: Array, beat: Array, level: Array) -> tuple[Array, Array]:
    """Rotations of chest on pelvis and head on chest: the chest stays upright, the head faces the front."""
    t = np.arange(len(body)) / FRAME_RATE_HZ
    chest = body[:, 2 * ARM : 2 * ARM + 3].copy()
    push, nod = (_groove(t, plans, name) * level[:, 2] for name in ("chest", "nod"))
    heading = turn[:, 0]
    chest[:, 0] -= 0.5 * np.tanh(heading - _soft(heading, 0.35))
    chest[:, 1] += push * beat - 0.35 * turn[:, 1]
    chest[:, 2] -= 1.2 * turn[:, 2]
    head = body[:, 2 * ARM + 3 :].copy()
    facing = heading + chest[:, 0]
    head[:, 0] -= 0.75 * np.tanh(facing / 0.75)
    head[:, 1] += nod * _soft(beat, 0.03) - 0.7 * (chest[:, 1] + turn[:, 1])
    head[:, 2] -= 0.5 * chest[:, 2] + 0.4 * turn[:, 2]
    return chest, head


def _soft(curve: Array, seconds: float) -> Array:
    """`smoothed`, in double precision."""
    return smoothed(curve.astype(np.float32), seconds).astype(np.float64)


def _pulse(t: Array, plans: list[DancePlan]) -> tuple[Array, Array]:
    """How far down the body is in each count (0..1), and (t, 3): bounce in metres, hip scale, presence 0..1."""
    beat = np.zeros(len(t))
    level = np.zeros((len(t), 3))
    for plan in plans:
        counts, groove = plan.counts, plan.counts.groove
        first, last = np.searchsorted(t, [plan.begin - 0.5, plan.settle + 1.5])
        own = t[first:last]
        number = _count(own, counts.times)
        period = counts.metre if counts.metre == 3 else (2 if groove.name in ("ballet", "rest") else 1)
        wave = (0.5 + 0.5 * np.cos(2 * np.pi * number / period)) ** groove.sharp
        if counts.unit > 1 or counts.metre == 3:  # add a wave on every beat to the longer one
            every = counts.unit if counts.unit > 1 else 1
            quick = 0.5 + 0.5 * np.cos(2 * np.pi * number * every)
            wave = 0.62 * wave + 0.38 * (1.0 - quick if groove.is_up else quick)
        beat[first:last] = 1.0 - wave if groove.is_up else wave
        ready = 4.0 * counts.length(0)
        presence = minimum_jerk((own - plan.begin + 0.1) / ready) * (1 - minimum_jerk((own - plan.settle + 0.05) / 0.7))
        keys = np.array([(time, b, h) for time, b, h in plan.level])
        scale = glide(own, keys[:, 0], keys[:, 1:], np.full(len(keys), 0.6))
        level[first:last, 0] = groove.bounce * scale[:, 0] * presence
        level[first:last, 1] = scale[:, 1] * presence
        level[first:last, 2] = presence
    return beat, level


def _count(t: Array, times: Array) -> Array:
    """Smoothed continuous count number at times `t`; the tempo continues beyond both ends."""
    gap0, gap1 = times[1] - times[0], times[-1] - times[-2]
    number: Array = np.interp(t, times, np.arange(len(times), dtype=np.float64))
    number = np.where(t < times[0], (t - times[0]) / gap0, number)
    number = np.where(t > times[-1], len(times) - 1 + (t - times[-1]) / gap1, number)
    return _soft(number - number[0], 0.05) + number[0] if len(t) else number


def _groove(t: Array, plans: list[DancePlan], name: str) -> Array:
    """A constant of each span's groove, eased in and out."""
    result = np.zeros(len(t))
    for plan in plans:
        rise = minimum_jerk((t - plan.begin) / 1.2)
        fall = 1 - minimum_jerk((t - plan.settle) / 0.8)
        result += float(getattr(plan.counts.groove, name)) * rise * fall
    return result


def _keyed(t: Array, plans: list[DancePlan], name: str) -> Array:
    """The pelvis curve through the keys called `name` of all plans."""
    keys = sorted((time, value) for plan in plans for time, value in getattr(plan, name))
    if not keys:
        return np.zeros(len(t))
    starts = [(plan.begin, 0.0) for plan in plans]
    table = np.array(sorted([*starts, *keys]))
    table = table[np.append(np.diff(table[:, 0]) > 1e-3, True)]
    curve = glide(t, table[:, 0], table[:, 1:], np.full(len(table), 1.2))
    return _soft(curve[:, 0], 0.04)


def _body(t: Array, plans: list[DancePlan]) -> Array:
    """Arms, chest and head, (frames, 38): glides from key to key, smoothed more where a move flows."""
    base = neutral(1)
    arms = np.concatenate([base.wrist, base.palm, base.elbow_swing[..., None], base.shoulder, base.fingers], axis=-1)
    rest = np.append(arms, np.zeros(6))
    rows = [BodyKey(-1.0, rest, 0.5, 0.0)]
    for plan in plans:
        rows.append(BodyKey(plan.begin + 0.05, rest, 0.5, 0.3))
        rows = _unhurried([*rows, *(key for key in plan.body if key.time > plan.begin + 0.3)])
        rows.append(BodyKey(max(plan.settle, rows[-1].time) + REST_SECONDS, rest, REST_SECONDS, 0.2))
    times = np.array([row.time for row in rows])
    values = np.stack([row.vector for row in rows])
    travel = np.maximum(np.array([row.travel for row in rows]), _needed(values))
    curve = glide(t, times, values, travel)
    _arch(curve, t, times, values, travel)
    gap = float(np.median([plan.counts.length(0) for plan in plans])) if plans else 0.5
    sharp, soft = _soft(curve, 0.028), _soft(curve, float(np.clip(0.22 * gap, 0.06, 0.22)))
    flow = glide(t, times, np.array([[row.flow] for row in rows]))
    return np.asarray(sharp + (soft - sharp) * _soft(flow, 0.15))


def _unhurried(rows: list[BodyKey]) -> list[BodyKey]:
    """Shorten moves for which there is not enough time; leave out those that would need far more."""
    kept = [rows[0]]
    for row in rows[1:]:
        needed = float(_needed(np.stack([kept[-1].vector, row.vector]))[1])
        short = needed / max(row.time - kept[-1].time, 1e-3)
        if short > 1.3:
            continue
        if short > 1.0:
            way = row.vector - kept[-1].vector
            row = replace(row, vector=kept[-1].vector + way / short)
        kept.append(row)
    return kept


def _needed(values: Array) -> Array:
    """Seconds that each move needs to keep wrists and upper arms below their top speeds."""
    wrists = values[:, : 2 * ARM].reshape(len(values), 2, ARM)[..., :3]
    before = np.concatenate([wrists[:1], wrists[:-1]])
    far = np.linalg.norm(wrists - before, axis=-1).max(1)
    lengths = np.linalg.norm(wrists, axis=-1) * np.linalg.norm(before, axis=-1)
    angle = np.arccos(np.clip((wrists * before).sum(-1) / lengths, -1.0, 1.0)).max(1)
    return np.asarray(1.875 * np.maximum(far / FASTEST_WRIST, angle / FASTEST_ARM), np.float64)


def _arch(curve: Array, t: Array, times: Array, values: Array, travel: Array) -> None:
    """Bend long wrist paths outwards and forwards, so that arms swing around the shoulder instead of through it."""
    before, after, phase = progress(t, times, gaps(times, travel))
    shape = air(phase)[:, None]
    for side in (0, 1):
        cut = slice(side * ARM, side * ARM + 3)
        start, end = values[:, cut][before], values[:, cut][after]
        middle = (start + end) / 2
        radius = (np.linalg.norm(start, axis=1) + np.linalg.norm(end, axis=1)) / 2
        away = middle + np.array([0.10, 0.0, 0.16])
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
        short = np.clip(0.96 * radius - np.linalg.norm(middle, axis=1), 0.0, 0.3)
        curve[:, cut] += away * short[:, None] * shape


def _follow_through(arms: Array) -> Float[Array, "t 2 3"]:
    """Hand angles with drag: the hand trails behind the movement of the wrist."""
    speed = np.gradient(_soft(arms[..., :3], 0.05), axis=0) * FRAME_RATE_HZ
    palm = _soft(arms[..., 3:6], 0.03)
    palm[..., 0] += 0.35 * np.tanh(speed[..., 1] / 1.2)
    palm[..., 1] += 0.12 * np.tanh(-speed[..., 2] / 1.5)
    return palm
