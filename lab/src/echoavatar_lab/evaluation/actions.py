"""Does an action do what its clip shows? Compares the same speech and seed with and without each action.

Not in the paper. Measured in the hips' frame on the points that the reference clip moves: joints, and a nose that shows
where the head is turned. The score is their mean distance from the clip's points in centimetres, without the action and
with it, over the stretch of the clip that defines the action. The generated body may lag by up to a third of a second.
Of head actions, beside which the body goes on with what it did, the nose alone counts, and the rotation range of the
head is reported. Everything is a mean over a few seeds, because in speech a hand may be close to the clip's by chance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Pipeline
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar.timing import CHUNK, FRAME_RATE_HZ
from echoavatar_lab.corpora.rehearsal.action_clips import SCRIPTS, clip

from .pictures import contact_sheet
from .takes import joined

BEGIN_CHUNKS = 8  # chunks of speech before the action
NOSE_M = 0.25  # distance of the nose point from the head joint
MOVED_M = 0.05  # the clip must move a point further than this for it to count
LATEST_FRAMES = 10
SEEDS = (0, 1, 2)

Points = Float[np.ndarray, "t p 3"]


class HeadTurn(NamedTuple):
    """Range of the head's rotation: degrees between its extremes, in the hips' frame."""

    yaw: float
    pitch: float


class ActionScore(NamedTuple):
    """One action: mean distance of the counted points from the clip's, without it and with it, and the motion."""

    name: str
    points: tuple[str, ...]  # points that the clip moves
    off_cm: float
    on_cm: float
    fastest_deg_s: float  # fastest joint, from the start of the action to its end
    motion: Motion
    peak: int  # frame of the motion in the middle of the action's hold
    head_off: HeadTurn  # during the hold
    head_on: HeadTurn
    head_clip: HeadTurn

    @property
    def is_head_action(self) -> bool:
        """Whether the clip is added on top of whatever the rest of the body does."""
        return SCRIPTS[self.name].is_on_top


def evaluate_actions(
    pipeline: Pipeline, audio: Float[np.ndarray, " s"], names: Sequence[str] = (), *, seeds: Sequence[int] = SEEDS
) -> list[ActionScore]:
    """Score all actions of the bundle that we have a reference clip of (or those in `names`), a batch for each seed."""
    chosen = list(names) or [name for name in SCRIPTS if name in pipeline.actions]
    runs = [_run(pipeline, audio, chosen, seed) for seed in seeds]
    return [_mean(same) for same in zip(*runs, strict=True)]


def _run(pipeline: Pipeline, audio: Float[np.ndarray, " s"], names: Sequence[str], seed: int) -> list[ActionScore]:
    longest = max(pipeline.actions[name].chunks for name in names)
    size = pipeline.chunk.samples
    samples = (BEGIN_CHUNKS + longest + 4) * size
    sound = np.resize(audio, samples)
    engine = Engine(pipeline, seats=len(names) + 1, rewind=0, workers=0)
    sessions = [engine.open(seed=seed) for _ in range(len(names) + 1)]
    made: list[list[MotionChunk]] = [[] for _ in sessions]
    for number in range(samples // size):
        if number == BEGIN_CHUNKS:
            for session, name in zip(sessions[1:], names, strict=True):
                session.act(name)
        for session in sessions:
            session.push(sound[number * size : (number + 1) * size])
        engine.tick()
        for chunks, session in zip(made, sessions, strict=True):
            chunks.extend(session)
    off, *on = (joined(pipeline.skeleton, chunks) for chunks in made)
    begin = BEGIN_CHUNKS * pipeline.chunk.frames
    return [_score_action(name, off, motion, begin) for name, motion in zip(names, on, strict=True)]


def _mean(runs: Sequence[ActionScore]) -> ActionScore:
    """Average one action over seeds; the motion is that of the first seed, the speed the maximum."""

    def turn(which: str) -> HeadTurn:
        return HeadTurn(*np.mean([getattr(run, which) for run in runs], 0).tolist())

    return runs[0]._replace(
        off_cm=float(np.mean([run.off_cm for run in runs])),
        on_cm=float(np.mean([run.on_cm for run in runs])),
        fastest_deg_s=max(run.fastest_deg_s for run in runs),
        head_off=turn("head_off"),
        head_on=turn("head_on"),
    )


def _score_action(name: str, off: Motion, on: Motion, begin: int = BEGIN_CHUNKS * CHUNK.frames) -> ActionScore:
    script = SCRIPTS[name]
    wanted = joints_and_nose(clip(script))
    moved = np.linalg.norm(wanted - wanted[:1], axis=-1).max(0) > MOVED_M
    if not moved.any():  # standing at ease concerns the whole body
        moved[:] = True
    if script.is_on_top:  # arms go on with what they did
        moved[:] = np.arange(len(moved)) == len(moved) - 1
    first, last = (round(second * FRAME_RATE_HZ) for second in script.hold)
    span = wanted[first:last, moved]

    def distance(motion: Motion) -> float:
        points = joints_and_nose(motion)[:, moved]
        starts = range(begin + first, begin + first + LATEST_FRAMES + 1)
        far = [np.linalg.norm(points[at : at + len(span)] - span, axis=-1).mean() for at in starts]
        return 100 * float(min(far))

    turns = np.abs((on.rotations[1:] * on.rotations[:-1]).sum(-1)).clip(0, 1)
    fastest = float(np.degrees(2 * np.arccos(turns[begin - 1 :])).max() * FRAME_RATE_HZ)
    names = (*on.skeleton.names, "nose")
    points = tuple(names[at] for at in np.flatnonzero(moved))
    peak, lasts = begin + (first + last) // 2, slice(begin + first, begin + last + LATEST_FRAMES)
    heads = head_turn(off, lasts), head_turn(on, lasts), head_turn(clip(script), slice(first, last))
    return ActionScore(name, points, distance(off), distance(on), fastest, on, peak, *heads)


def head_turn(motion: Motion, frames: slice) -> HeadTurn:
    """Rotation range of the head relative to the hips."""
    points = joints_and_nose(motion)[frames]
    x, y, z = ((points[:, -1] - points[:, motion.skeleton.index("head")]) / NOSE_M).T
    yaw, pitch = np.unwrap(np.arctan2(x, z)), np.arcsin(np.clip(y, -1, 1))
    return HeadTurn(*(float(np.degrees(np.ptp(angle))) for angle in (yaw, pitch)))


def joints_and_nose(motion: Motion) -> Points:
    """Joints and nose in the hips' frame, metres."""
    skeleton, pose = motion.skeleton, motion.pose()
    positions, head = pose.positions, skeleton.index("head")
    ahead = pose.rotations[:, head] @ np.array([0, 0, NOSE_M], np.float32)
    points = np.concatenate([positions, (positions[:, head] + ahead)[:, None]], axis=1) - positions[:, :1]
    hips = matrix_from_quaternion(motion.rotations[:, 0])
    return np.asarray(points @ hips)


def sheet(acted: Sequence[ActionScore]) -> UInt8[np.ndarray, "h w 3"]:
    """The body in the middle of each action's hold, side by side."""
    rotations, root = (
        np.stack([getattr(one.motion, part)[one.peak] for one in acted]) for part in ("rotations", "root")
    )
    root[:, [0, 2]] = 0
    motion = Motion(acted[0].motion.skeleton, rotations, root, float(FRAME_RATE_HZ))
    columns = min(5, len(acted))
    return contact_sheet(motion, columns=columns, rows=-(-len(acted) // columns), every=1)
