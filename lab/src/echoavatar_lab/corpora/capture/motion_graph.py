"""Walks through captured clips: stretches joined where pose and velocity match (after Kovar et al., 2002).

A join may happen while both feet stand. The new stretch is turned and shifted on the floor so that the bodies coincide;
what still differs fades out (inertialisation). A foot that lands a little beside its place stays there until the new
stretch lifts it; one that lands far from it takes a step of its own.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.spatial.distance import cdist

from echoavatar.errors import MotionError
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.corpora.controls import (
    ANKLE_HEIGHT,
    FEET,
    Array,
    Controls,
    air,
    at_most,
    concatenated,
    fading,
    gap,
    minimum_jerk,
    mirrored,
    moved,
    smoothed,
    spans_of,
    turned,
    unwound,
)

from .library import CapturedLibrary

IDLE, TALKING = 0.25, 1.0  # liveliness of bodies that wait, and of those that talk
SHORTEST_S = 4.0  # of a clip
EVERY = 5  # frames between places where a join may happen
AHEAD_S = 5.0  # what a place leads to is judged over this time
STRETCH_S = 4.0, 11.0  # of one clip
SAMPLED = 500  # places compared for one join
GOOD_JOINS = 6  # of which one of the best is drawn
VELOCITY_S = 0.15  # weight of velocities against positions
FADE_S, STEP_S = 0.9, 0.46
KEPT_M, KEPT_RAD = 0.07, 0.25  # a foot that is off by less keeps its place
NEAR_M, FRONT_RAD = 0.25, 0.45  # a body further off is brought back by steps
TALKERS = {"sway": 0.084, "lean": 0.077, "turn": 0.082, "feet": 0.08}  # people talking: metres, radians, m/s
LEVEL = 0.7  # of a larger lean is taken back by the head, which looks ahead
WEIGHTS = {"sway": 0.3, "lean": 0.4, "turn": 0.2, "feet": 0.3}  # of these in the choice of what comes next
CHOICE, LEAST = 0.35, 0.05  # width of the choice, in powers of e
LEAN, LEAN_ASIDE = 0.35, 0.18  # radians; a body that leans further is left out
FOOT_M = 0.03  # from the middle of a foot to its outer edge
USED = 0.2  # odds of a clip each time that it was used in the same walk
STEPPING = 0.5  # of the joins of a lively body are made by steps
QUIET = 0.5  # below this liveliness nothing is chosen
SIZES = {"sway": (0.7, 1.4), "lean": (0.7, 2.5), "turn": (0.7, 1.4)}  # by which a stretch is scaled
TILT = 0.85  # of a stretch's own tilt to the sides at most, however far it sways


class MotionGraph:
    """Clips and their mirror images, with the pose, the velocity and the liveliness of every place in them."""

    def __init__(self, clips: Sequence[Controls], waiting: Sequence[bool]) -> None:
        """`waiting` tells of each clip whether bodies that wait may do what it shows."""
        self.clips = [side for clip in clips for side in (clip, mirrored(clip))]
        frames = [np.arange(len(clip))[::EVERY] for clip in self.clips]
        self.clip = np.concatenate([np.full(len(f), i) for i, f in enumerate(frames)])
        self.frame = np.concatenate(frames)
        described = zip(*(_described(clip) for clip in self.clips), strict=True)
        self.poses, self.arms, self.stands, self.alive = (
            np.concatenate([curve[::EVERY] for curve in curves]) for curves in described
        )
        self.waits = np.repeat(waiting, 2)[self.clip]
        self.left = np.concatenate([len(c) - f for c, f in zip(self.clips, frames, strict=True)])

    def entries(self, wanted: float, seconds: float) -> Int[Array, " k"]:
        """Places where both feet stand, nothing wild follows, and the clip goes on for some seconds."""
        fits = self.stands & np.isfinite(self.alive).all(1) & (self.left > seconds * FRAME_RATE_HZ)
        return np.flatnonzero(fits & self.waits if wanted < QUIET else fits)

    def best_joins(
        self, here: Int[np.ndarray, " m"], there: Int[np.ndarray, " k"], *, has_arms: bool
    ) -> tuple[Float[Array, " k"], Int[Array, " k"]]:
        """For each place `there` the least distance from a place `here`, and which it is."""
        apart = cdist(self.poses[here], self.poses[there], "sqeuclidean")
        if has_arms:
            apart += cdist(self.arms[here], self.arms[there], "sqeuclidean")
        return np.sqrt(apart.min(0)), here[apart.argmin(0)]


def _described(
    controls: Controls,
) -> tuple[Float[Array, "t d"], Float[Array, "t a"], Bool[Array, " t"], Float[Array, "t 4"]]:
    """Pose and velocity of the body and of the arms, in metres, seen from the hips over the floor; whether both feet
    stand; and the liveliness of what follows.
    """
    yaw = controls.pelvis_rotation[:, :1]
    feet = turned(controls.foot_position - controls.pelvis_position[:, None], -yaw)
    toes = controls.foot_yaw - yaw
    parts = [
        feet.reshape(len(feet), -1),
        0.13 * np.concatenate([np.sin(toes), np.cos(toes), controls.foot_pitch], 1),
        controls.pelvis_position[:, 1:2],
        0.5 * controls.pelvis_rotation[:, 1:],
        0.4 * controls.spine,
        0.15 * controls.head,
    ]
    arms = np.concatenate([controls.wrist.reshape(len(feet), -1), 0.1 * controls.elbow_swing], 1)
    steps = np.linalg.norm(np.gradient(controls.foot_position, axis=0), axis=-1) * FRAME_RATE_HZ
    stands = ((controls.foot_position[..., 1] < ANKLE_HEIGHT + 0.012) & (steps < 0.06)).all(1)
    poses = _with_velocity(np.concatenate(parts, 1))
    return poses, _with_velocity(arms), stands, _liveliness(controls, yaw, steps)


def _with_velocity(pose: Float[Array, "t d"]) -> Float[Array, "t e"]:
    velocity = np.gradient(smoothed(pose, 0.03), axis=0) * FRAME_RATE_HZ
    return np.concatenate([pose, VELOCITY_S * velocity], 1).astype(np.float32)


def _liveliness(controls: Controls, yaw: Array, steps: Array) -> Float[Array, "t 4"]:
    """Sway, lean, turn and steps of the next seconds, 1 like people who talk; infinite before wild or far moves."""
    place, lean, curves = controls.pelvis_position, _lean(controls), _sway_lean_turn(controls)
    window = min(round(AHEAD_S * FRAME_RATE_HZ), len(yaw))

    def ahead(values: Array) -> Array:
        mean: Array = uniform_filter1d(values.astype(np.float64), window, mode="nearest", origin=-(window // 2))
        return mean

    found = [np.sqrt((ahead(c**2) - ahead(c) ** 2).clip(0)) / TALKERS[name] for name, c in curves.items()]
    found.append(ahead(steps.mean(1)) / TALKERS["feet"])
    aside = controls.pelvis_rotation[:, 2] + 0.55 * controls.spine[:, 2]
    wild = (np.abs(lean) > LEAN) | (np.abs(aside) > LEAN_ASIDE) | (place[:, 1] < 0.82)
    wild |= np.abs(controls.spine[:, 0]) > 0.7
    wild |= overhang(controls) > 1.15
    away = np.stack([np.sin(yaw[:, 0]), np.cos(yaw[:, 0]), place[:, 0], place[:, 2]])
    spread = sum(ahead(c**2) - ahead(c) ** 2 for c in away)
    is_out = (ahead(wild.astype(float)) > 0) | (spread > 0.07)
    return np.where(is_out[:, None], np.inf, np.stack(found, 1))


@lru_cache(maxsize=2)
def standing_graph(library: CapturedLibrary) -> MotionGraph:
    """People who stand, shift their weight and look about; bodies that talk also do what clips of speech show.

    Raises MotionError if the library has nobody who stands.
    """
    clips = [clip for clip in library.of("standing", "speech", "gesture") if clip.seconds > SHORTEST_S]
    waiting = [clip.kind == "standing" for clip in clips]
    if not any(waiting):
        raise MotionError("the library has no clip of kind standing longer than 4 s; bodies need one")
    return MotionGraph([clip.controls for clip in clips], waiting)


def walk(graph: MotionGraph, liveliness: Float[np.ndarray, " t"], rng: np.random.Generator) -> Controls:
    """A walk of `len(liveliness)` frames near the origin that mostly faces +Z; follows the wanted liveliness."""
    frames, entries = len(liveliness), graph.entries(float(liveliness[0]), 2.0)
    body, at = None, 0
    fresh = np.ones(len(graph.clips))
    here = int(rng.choice(entries, p=_appeal(graph, entries, float(liveliness[0]), fresh)))
    while at < frames:
        length = round(float(rng.uniform(*STRETCH_S)) * FRAME_RATE_HZ)
        change = np.flatnonzero(np.diff(liveliness[at : at + length]))
        length = int(change[0]) + 1 if len(change) else length
        own = graph.clip[here] // 2 * 2
        fresh = np.minimum(1.0, fresh**0.8)  # what was seen some stretches ago may come again
        fresh[own : own + 2] *= USED
        leaves, here_next = _next_join(graph, here, max(length, FRAME_RATE_HZ), liveliness, at, fresh, rng)
        clip, first = graph.clips[graph.clip[here]], int(graph.frame[here])
        piece = _sized(clip[first : graph.frame[leaves]], float(liveliness[min(at, frames - 1)]), rng)
        is_stepping = liveliness[min(at, frames - 1)] > QUIET and rng.random() < STEPPING
        spot = rng.normal(0.0, (0.08, 0.05, 0.15)) if is_stepping else None
        body = piece if body is None else joined(body, piece, spot)
        body = _home(body) if at == 0 else body
        at, here = len(body), here_next
    assert body is not None
    return body[:frames]


def _appeal(graph: MotionGraph, places: Array, wanted: float, fresh: Float[Array, " clips"]) -> Float[Array, " n"]:
    """Probability of each place: near the wanted liveliness; as often as captured for bodies that wait."""
    odds = fresh[graph.clip[places]]
    if wanted < QUIET:
        return np.asarray(odds / odds.sum())
    off = np.log((graph.alive[places] + LEAST) / (wanted + LEAST)) / CHOICE
    odds = odds * (np.exp(-0.5 * (off**2) @ np.array(list(WEIGHTS.values()))) + 1e-12)
    return np.asarray(odds / odds.sum())


def _next_join(
    graph: MotionGraph,
    here: int,
    length: int,
    liveliness: Array,
    at: int,
    fresh: Float[Array, " clips"],
    rng: np.random.Generator,
) -> tuple[int, int]:
    """Where to leave the present clip and where to go: among places of the wanted kind, one of the nearest."""
    wanted = float(liveliness[min(at + length, len(liveliness) - 1)])
    rest = np.arange(here + 1, here + graph.left[here] // EVERY)
    late = np.abs((graph.frame[rest] - graph.frame[here]) - length)
    stands = graph.stands[rest] & (graph.frame[rest] - graph.frame[here] >= FRAME_RATE_HZ)
    ways_out = rest[stands][np.argsort(late[stands])[:8]] if stands.any() else rest[-1:]
    entries = graph.entries(wanted, 2.5)
    there = rng.choice(entries, size=SAMPLED, p=_appeal(graph, entries, wanted, fresh))
    apart, leaves = graph.best_joins(ways_out, there, has_arms=wanted < QUIET)
    apart = apart + np.where((graph.clip[there] == graph.clip[here]) & (np.abs(there - here) < 60), 1.0, 0.0)
    best = int(rng.choice(np.argsort(apart)[:GOOD_JOINS]))
    return int(leaves[best]), int(there[best])


def _sized(controls: Controls, wanted: float, rng: np.random.Generator) -> Controls:
    """A stretch scaled towards people who talk if it is to be lively, and by chance otherwise."""
    if wanted < QUIET:
        size = float(rng.uniform(*SIZES["sway"]))
        return varied(controls, sway=size, lean=size, turn=size)
    own = {name: float(curve.std()) / TALKERS[name] for name, curve in _sway_lean_turn(controls).items()}
    goal = {name: wanted * float(rng.uniform(0.8, 1.25)) for name in SIZES}
    sizes = {name: float(np.clip(goal[name] / (own[name] + 1e-3), *SIZES[name])) for name in SIZES}
    sizes["sway"] = min(sizes["sway"], max(0.7, 1 / max(float(overhang(controls).max()), 1e-3)))
    farthest = float(np.abs(_lean(controls) - _lean(controls).mean()).max())
    sizes["lean"] = min(sizes["lean"], max(0.7, 0.8 * LEAN / max(farthest, 1e-3)))
    return varied(controls, **sizes)


def varied(controls: Controls, *, sway: float, lean: float, turn: float) -> Controls:
    """The same stretch with a larger or smaller sway, lean, and turn of trunk and head; feet as they are."""
    middle = smoothed(controls.foot_position.mean(1), 0.3)
    over = (controls.pelvis_position - middle).astype(np.float64)
    over[:, [0, 2]] += (sway - 1) * (over - over.mean(0))[:, [0, 2]]
    pelvis, spine, head = (
        curve + (curve - curve.mean(0)) * (np.array(sizes) - 1)
        for curve, sizes in (
            (controls.pelvis_rotation, (1.0, lean, min(sway, TILT))),
            (controls.spine, (turn, lean, min(sway, TILT))),
            (controls.head, (turn, 1.0, min(sway, TILT))),
        )
    )
    head[:, 1] -= (lean - 1) * (_lean(controls) - _lean(controls).mean()) * LEVEL
    return replace(
        controls,
        pelvis_position=(middle + over).astype(np.float32),
        pelvis_rotation=pelvis.astype(np.float32),
        spine=spine.astype(np.float32),
        head=head.astype(np.float32),
    )


def overhang(controls: Controls) -> Float[Array, " t"]:
    """How far the hips are from the middle between the feet along their line, 1 above the outer edge of a foot."""
    feet = controls.foot_position[:, :, [0, 2]]
    across = (feet[:, 0] - feet[:, 1]) / 2
    half = np.linalg.norm(across, axis=1)
    off = ((controls.pelvis_position[:, [0, 2]] - feet.mean(1)) * across).sum(1) / np.maximum(half, 1e-3)
    return np.asarray(np.abs(smoothed(off, 0.1)) / (half + FOOT_M))


def _sway_lean_turn(controls: Controls) -> dict[str, Float[Array, " t"]]:
    side = controls.pelvis_position[:, 0]
    sway = side - gaussian_filter1d(side, 4 * FRAME_RATE_HZ)
    return {"sway": sway, "lean": _lean(controls), "turn": controls.spine[:, 0]}


def _lean(controls: Controls) -> Float[Array, " t"]:
    """Angle of the line from the hips to the shoulders; the spine bends along its length."""
    return np.asarray(controls.pelvis_rotation[:, 1] + 0.55 * controls.spine[:, 1])


def joined(before: Controls, after: Controls, spot: Float[np.ndarray, " 3"] | None = None) -> Controls:
    """`before`, then `after` moved to where the body stands; pose and velocity stay continuous, feet do not slide.

    With a `spot` (x, z, yaw) the body steps to it instead, as far as two steps lead.
    """
    after = _brought(before, after, spot)
    curves: dict[str, Array] = {}
    for field in fields(Controls):
        if field.name not in FEET:
            old, new = getattr(before, field.name), getattr(after, field.name).copy()
            new += fading(*gap(old, new), round(FADE_S * FRAME_RATE_HZ), len(new))
            curves[field.name] = new
    curves |= _feet(before, after)
    return concatenated([before, replace(after, **curves)])


def _brought(before: Controls, after: Controls, spot: Array | None) -> Controls:
    """`after` where `before` ends, by the best fit of ankles, toes and hips on the floor, and then towards home."""
    old, new = _floor_points(before[-1:]), _floor_points(after[:1])
    a, b = old - old.mean(0), new - new.mean(0)
    turn = float(np.arctan2((b[:, 1] * a[:, 0] - b[:, 0] * a[:, 1]).sum(), (a * b).sum()))
    placed = moved(moved(after, -new.mean(0)), old.mean(0), turn=turn)
    placed = unwound(placed, before, 0, -1)
    goal = np.zeros(3) if spot is None else spot
    off = placed.pelvis_position[:, [0, 2]].mean(0) - goal[:2]
    yaw = float(placed.pelvis_rotation[:, 0].mean() - goal[2])
    far = float(np.hypot(*off))
    is_lost = spot is not None or far > NEAR_M or abs(yaw) > FRONT_RAD
    shift, angle = (0.35, 0.7) if is_lost else (0.03, 0.05)
    centre = placed.pelvis_position[0, [0, 2]]
    turn = -float(np.clip(yaw, -angle, angle))
    return moved(moved(placed, -centre), centre - at_most(off, shift), turn=turn)


def _home(body: Controls) -> Controls:
    """A first stretch over the origin, facing +Z on average."""
    body = moved(body, -body.pelvis_position[:, [0, 2]].mean(0))
    return moved(body, np.zeros(2), turn=-float(body.pelvis_rotation[:, 0].mean()))


def _floor_points(controls: Controls) -> Float[Array, "5 2"]:
    """Ankles, toes and hips of one frame, seen from above; the hips count little."""
    ankles = controls.foot_position[0][:, [0, 2]]
    yaw = controls.foot_yaw[0]
    toes = ankles + 0.13 * np.stack([np.sin(yaw), np.cos(yaw)], -1)
    return np.concatenate([ankles, toes, controls.pelvis_position[:, [0, 2]]])


def _feet(before: Controls, after: Controls) -> dict[str, Array]:
    """The feet of `after`, each kept in its place until it is lifted, or stepping to its new one at once."""
    curves = {name: getattr(after, name).copy() for name in FEET}
    way = [before.foot_position[-1, s] - after.foot_position[0, s] for s in range(2)]
    turn = [float(before.foot_yaw[-1, s] - after.foot_yaw[0, s]) for s in range(2)]
    must = [float(np.hypot(w[0], w[2])) > KEPT_M or abs(t) > KEPT_RAD for w, t in zip(way, turn, strict=True)]
    frames, step = len(after), round(STEP_S * FRAME_RATE_HZ)
    lead = int(np.argmax([np.hypot(w[0], w[2]) for w in way]))
    for side in range(2):
        if must[side]:
            begin, length = 2 if side == lead or not all(must) else step + 4, step
        else:
            begin, end = _first_step(after, side)
            length = max(end - begin, round(0.25 * FRAME_RATE_HZ))
        phase = (np.arange(frames) - begin) / length
        stay = 1 - minimum_jerk((phase - 0.12) / 0.76)
        fade = 1 - minimum_jerk(np.arange(frames) / (0.3 * FRAME_RATE_HZ))
        flat = np.array([way[side][0], 0.0, way[side][2]], np.float32)
        held = np.arange(frames) < begin
        if must[side]:  # the new stretch's own foot may move meanwhile; this one waits
            for name in FEET:
                curves[name][held, side] = curves[name][min(begin, frames - 1), side]
            flat = before.foot_position[-1, side] - curves["foot_position"][0, side]
            turn[side] = float(before.foot_yaw[-1, side] - curves["foot_yaw"][0, side])
            flat = np.array([flat[0], 0.0, flat[2]], np.float32)
        curves["foot_position"][:, side] += stay[:, None] * flat
        curves["foot_yaw"][:, side] += (stay * turn[side]).astype(np.float32)
        for name in ("foot_pitch", "foot_roll"):
            rest = getattr(before, name)[-1, side] - getattr(after, name)[0, side]
            curves[name][:, side] += (fade * rest).astype(np.float32)
        curves["foot_position"][:, side, 1] += fade * way[side][1]
        if must[side]:
            far = float(np.hypot(flat[0], flat[2])) + 0.1 * abs(turn[side])
            curves["foot_position"][:, side, 1] += (0.02 + min(0.2 * far, 0.05)) * air(phase)
            curves["foot_pitch"][:, side] += min(0.9 * far, 0.25) * air(np.clip(phase / 0.7, 0, 1))
    return curves


def _first_step(controls: Controls, side: int) -> tuple[int, int]:
    """First frame in which a foot leaves the floor, and first after it in which it stands; the length if it stays."""
    steps = spans_of(controls.foot_position[:, side, 1] > ANKLE_HEIGHT + 0.012)
    return steps[0] if steps else (len(controls), len(controls))
