"""`echoavatar evaluate --domains`: how often the body dances to speech, and gestures to music.

Paper, Discussions: male speech is taken for song, and the avatar dances. Measured here: a frame is danced if the hips
and knees rotate by more than `DANCING` degrees a second in the mean over the two seconds around it, as in
`engine.settling`; it is gestured if it is not danced and the arms' joints do so. What is neither is rest. Captured
people are measured in the same way: the definition is only as good as it tells their dances from their talking.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d

from echoavatar.engine import animate_many
from echoavatar.engine.pipeline import Pipeline
from echoavatar.engine.settling import DANCES_S, DANCING
from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import Motion
from echoavatar.motion.kinematics.rigs import known_bones

from .alive import Sound, Take

LEGS = ("leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg")
ARMS = ("leftUpperArm", "rightUpperArm", "leftLowerArm", "rightLowerArm")


class Shares(NamedTuple):
    """Of one class of sound: how long it is, and the shares of its frames, 0 to 1; the rest is neither."""

    kind: str
    group: str
    takes: int
    seconds: float
    danced: float
    gestured: float


def danced(motion: Motion) -> Bool[np.ndarray, " t"]:
    """Of each frame whether the legs dance in the two seconds around it."""
    return _pace(motion, LEGS) > DANCING


def gestured(motion: Motion) -> Bool[np.ndarray, " t"]:
    """Of each frame whether the arms move and the legs do not dance."""
    return np.asarray((_pace(motion, ARMS) > DANCING) & ~danced(motion))


def perform(pipeline: Pipeline, sounds: Sequence[Sound], *, seed: int = 0) -> list[Take]:
    """The avatar's motion to each sound, each with a seed of its own."""
    made = animate_many(pipeline, [sound.audio for sound in sounds], seeds=range(seed, seed + len(sounds)))
    return [Take(*sound[:3], one.motion) for sound, one in zip(sounds, made, strict=True)]


def shares(takes: Iterable[Take]) -> list[Shares]:
    """The shares of every class, and of each kind as a whole (class "all"), in order of kind and class."""
    kept = list(takes)
    groups = dict.fromkeys((take.kind, group) for take in kept for group in ("all", take.group) if group)
    return [
        _share(kind, group, [take.motion for take in kept if take.kind == kind and group in ("all", take.group)])
        for kind, group in sorted(groups, key=lambda key: (key[0], key[1] != "all", key[1]))
    ]


def as_text(rows: Sequence[Shares]) -> str:
    """A table in Markdown; shares in percent."""
    lines = ["| sound | class | takes | s | danced, % | gestured, % |", "|---|---|---:|---:|---:|---:|"]
    for row in rows:
        numbers = f"{row.takes} | {row.seconds:.0f} | {100 * row.danced:.0f} | {100 * row.gestured:.0f}"
        lines.append(f"| {row.kind} | {row.group} | {numbers} |")
    return "\n".join(lines)


def _share(kind: str, group: str, motions: Sequence[Motion]) -> Shares:
    dance, gesture = (np.concatenate([mark(motion) for motion in motions]) for mark in (danced, gestured))
    seconds = sum(motion.seconds for motion in motions)
    return Shares(kind, group, len(motions), seconds, float(dance.mean()), float(gesture.mean()))


def _pace(motion: Motion, names: Sequence[str]) -> Float[np.ndarray, " t"]:
    """Mean rotation speed of joints (degrees per second) in the two seconds around each frame."""
    bones = known_bones(motion.skeleton)
    if missing := [name for name in names if name not in bones]:
        raise MotionError(f"no joint of the rig is {missing[0]}; give its skeleton a VRM map")
    rotations = motion.rotations[:, [bones[name] for name in names]]
    if len(rotations) < 2:
        return np.zeros(len(rotations))
    now, then = rotations[1:], rotations[:-1]
    half = np.minimum(np.linalg.norm(now - then, axis=-1), np.linalg.norm(now + then, axis=-1))
    speed = np.degrees(2 * half).mean(1) * motion.fps
    frames = min(len(speed), round(DANCES_S * motion.fps))
    return np.asarray(uniform_filter1d(np.concatenate([speed[:1], speed]), frames, mode="nearest"))
