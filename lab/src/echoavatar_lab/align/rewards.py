"""Reward functions: plain functions of a motion, selected by name and combined by weight.

A function takes a `DecodedMotion` and the `ReferenceStatistics` and returns one number, or one for each new frame.
Values by frame can be credited to the codes that made the frame; their sum is the reward of the motion. The built-in
rewards are about 1 for motion like the truth and fall below 0 far from it. You can write your own:

    def high_hands(motion, reference_statistics):
        return motion.positions[motion.lead :, motion.skeleton.index("leftHand"), 1].mean()

    rewards = RewardMix({"trunk": 1.0, "high_hands": 0.5}, reference_statistics, own={"high_hands": high_hands})

The reference statistics tell how fast, how far and how smoothly true motion moves. These rewards are ours; the paper's
alignment reward is the learned embedding in `audio_reward`.
"""

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from jaxtyping import Float
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_object_file
from echoavatar.timing import FRAME_RATE_HZ, FRAMES_PER_MOTION_TOKEN
from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab.data.faults import skate
from echoavatar_lab.evaluation.metrics.beat_alignment import (
    ARM_JOINTS,
    SHARP_SIGMA_S,
    STROKE_DELAY_S,
    dance_beats,
    gesture_beats,
    hits,
)
from echoavatar_lab.evaluation.metrics.liveliness import yaw
from echoavatar_lab.evaluation.metrics.positions import jerk_m_s3

from .decoded_motion import DecodedMotion

Movement = tuple[float, float, float, float]


class JsonFile(Config):
    """A config in a JSON file of its own."""

    remedy: ClassVar[str]
    """What such a file holds, and how it is made: the end of the message where one cannot be read."""

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote. Raises CheckpointError if the file is missing or holds something else."""
        try:
            return cls.model_validate(read_object_file(path))
        except (OSError, EchoAvatarError, ValidationError) as error:
            raise CheckpointError(f"{path} holds no {cls.remedy}") from error

    def save(self, path: Path) -> None:
        """Write as JSON."""
        make_output_folder(path.parent)
        write_whole(path, self.model_dump_json(indent=1) + "\n")


class ReferenceStatistics(JsonFile):
    """Measured once, on the true motion of the training clips."""

    remedy = "reference statistics; let `echoavatar align grpo` measure them again"

    speed: tuple[float, float, float] = Field(description="mean speed (m/s) in silence, speech, music")
    movement: tuple[Movement, Movement, Movement] = Field(description="mean of `body_movement` in the same domains")
    jerk: float = Field(gt=0, description="mean jerk, m/s3")
    scenes: int = Field(gt=0, description="number of motions measured")


def measure_reference_statistics(scenes: Sequence[DecodedMotion]) -> ReferenceStatistics:
    """Mean levels of true motion, by domain."""
    speeds = np.concatenate([motion.speed() for motion in scenes])
    domains = np.concatenate([motion.domain[motion.lead :] for motion in scenes])
    level = [float(speeds[domains == d].mean()) if (domains == d).any() else 0.0 for d in range(3)]
    moved = np.concatenate([body_movement(motion) for motion in scenes])
    movement = [moved[domains == d].mean(0) if (domains == d).any() else np.zeros(4) for d in range(3)]
    jerk = float(np.mean([jerk_m_s3(motion.positions) for motion in scenes]))
    return ReferenceStatistics(
        speed=(level[0], level[1], level[2]),
        movement=tuple(tuple(float(value) for value in row) for row in movement),  # type: ignore[arg-type]
        jerk=max(jerk, 1e-6),
        scenes=len(scenes),
    )


def body_movement(motion: DecodedMotion) -> Float[np.ndarray, "t 4"]:
    """Movement of trunk and feet in the new frames.

    How far the shoulders are turned against the hips and the trunk leans along Z, in radians, and how far the hips are
    to the side along X, in metres, each about its own mean; and the mean speed of the ankles, m/s.
    """
    new, at = motion.positions[motion.lead :], motion.skeleton.index
    shoulders, hips = (new[:, at("left" + bone)] - new[:, at("right" + bone)] for bone in ("UpperArm", "UpperLeg"))
    turn = np.unwrap(yaw(shoulders) - yaw(hips))
    trunk = (new[:, at("leftUpperArm")] + new[:, at("rightUpperArm")]) / 2 - new[:, 0]
    about = np.stack([turn, np.arctan2(trunk[:, 2], trunk[:, 1]), new[:, 0, 0]], 1)
    feet = motion.positions[:, [at("leftFoot"), at("rightFoot")]]
    ankles = np.linalg.norm(np.diff(feet, axis=0, prepend=feet[:1]), axis=-1).mean(1)[motion.lead :] * FRAME_RATE_HZ
    return np.concatenate([np.abs(about - about.mean(0)), ankles[:, None]], 1)


Reward = Callable[[DecodedMotion, ReferenceStatistics], float | Float[np.ndarray, " t"]]

FREE_JERK, MOST_JERK = 2.0, 4.0  # multiples of the truth's mean jerk; strokes briefly reach twice the mean
FREE_RATIO = 1.5  # factor by which speed may differ from the truth's without cost
MOST_MOVEMENT = 3.0  # multiples of the truth's mean movement; more does not pay


def beat_alignment(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """BA_D (`sharp`) minus chance, the mean score of an event at any time. By frame; the sum is the score."""
    return _excess(motion, [dance_beats(motion.positions)], motion.beats)


def stress_alignment(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """BA_G (`sharp`) of the arms on stressed syllables minus chance, as above; strokes end 0.18 s later."""
    arms = motion.skeleton.indices(ARM_JOINTS)
    return _excess(motion, gesture_beats(motion.positions[:, arms]), motion.stresses + STROKE_DELAY_S)


def whole_body(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """How much trunk and feet move, over the truth's for this domain; 0 in silence. Divided by the frames.

    Without it, a policy that is paid for timing moves the arms on the beat and lets the rest of the body rest.
    """
    return np.asarray(_movement(motion, reference_statistics).mean(1))


def trunk(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """How far the shoulders turn and the trunk leans alone, over the truth's as above."""
    return np.asarray(_movement(motion, reference_statistics)[:, :2].mean(1))


def smoothness(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """0 while jerk is at most twice the truth's mean, otherwise minus the excess, at most 4; divided by the frames.

    By frame, because a jolt comes only from the codes right before it.
    """
    jerk = np.linalg.norm(np.diff(motion.positions - motion.positions[:, :1], n=3, axis=0), axis=-1).mean(1)
    excess = np.clip(jerk * FRAME_RATE_HZ**3 / reference_statistics.jerk - FREE_JERK, 0, MOST_JERK)
    late = excess[max(0, motion.lead - 3) :]
    return np.asarray(-np.concatenate([np.zeros(motion.frames - len(late)), late]) / motion.frames)


def planted_feet(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> float:
    """Minus the sliding speed of the planted balls of the feet in dm/s, at least -3 (before the pipeline's leg IK)."""
    balls = list(motion.skeleton.config.feet)[1::2]
    standing = motion.skeleton.rest_positions[balls, 1]
    return max(-3.0, -0.1 * skate(motion.positions[:, balls], FRAME_RATE_HZ, standing_height=standing))


def liveliness(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> float:
    """0 while the mean speed is within a factor 1.5 of the truth's for this domain, otherwise minus the log excess."""
    domain, speed = motion.domain[motion.lead :], motion.speed()
    heard = int(np.bincount(domain, minlength=3).argmax())
    wanted = reference_statistics.speed[heard]
    if heard == 0 or wanted <= 0:
        return 0.0
    return -max(0.0, abs(float(np.log((speed.mean() + 1e-3) / wanted))) - float(np.log(FREE_RATIO)))


def stillness(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """Minus the hands' speed over their speed in speech, in silent frames; 0 elsewhere. Divided by the frames."""
    hands = motion.skeleton.indices(("leftHand", "rightHand"))
    speed = motion.speed(hands) / max(reference_statistics.speed[1], 1e-3)
    silent = motion.domain[motion.lead :] == 0
    return np.asarray(np.where(silent, -np.minimum(speed, 3.0), 0.0) / motion.frames)


def _movement(motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, "t 4"]:
    domain = motion.domain[motion.lead :]
    levels = np.maximum(np.array(reference_statistics.movement), 1e-3)  # one row a domain
    shares = np.minimum(body_movement(motion) / levels[domain], MOST_MOVEMENT)
    return np.asarray(np.where(domain[:, None] > 0, shares, 0.0) / motion.frames)


def _excess(
    motion: DecodedMotion, found: Sequence[np.ndarray], events: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " t"]:
    """By frame: the hit of each event, minus the mean hit of an event anywhere between the first and the last."""
    out, frame = np.zeros(motion.frames), np.arange(motion.frames) / FRAME_RATE_HZ
    events = events[events < motion.frames / FRAME_RATE_HZ]
    if len(events) < 2:  # one event has no time around it that chance could be measured in
        return out
    times = [own - motion.lead / FRAME_RATE_HZ for own in found]
    hit, anywhere = (np.mean([hits(at, own, SHARP_SIGMA_S) for own in times], 0) for at in (events, frame))
    between = (frame >= events[0]) & (frame <= events[-1])
    np.add.at(out, np.floor(events * FRAME_RATE_HZ).astype(int), hit / len(events))
    out[between] -= anywhere[between] / between.sum()
    return out


BUILT_IN: dict[str, Reward] = {
    "beat_alignment": beat_alignment,
    "stress_alignment": stress_alignment,
    "whole_body": whole_body,
    "trunk": trunk,
    "smoothness": smoothness,
    "planted_feet": planted_feet,
    "liveliness": liveliness,
    "stillness": stillness,
}


class Rewards(NamedTuple):
    """Weighted rewards of continuations."""

    tokens: Float[np.ndarray, "r n"]  # reward by motion token
    whole: Float[np.ndarray, " r"]  # reward of the whole continuation, which belongs to no particular time
    parts: dict[str, Float[np.ndarray, " r"]]  # each component's sum, without its weight

    @property
    def total(self) -> Float[np.ndarray, " r"]:
        """One number for each continuation."""
        return np.asarray(self.tokens.sum(1) + self.whole)


class RewardMix:
    """A weighted sum of reward functions."""

    def __init__(
        self,
        weights: Mapping[str, float],
        reference_statistics: ReferenceStatistics | None,
        own: Mapping[str, Reward] | None = None,
    ) -> None:
        """`reference_statistics` may be None if there are no weights."""
        known = BUILT_IN | dict(own or {})
        self.weights, self.reference_statistics = dict(weights), reference_statistics
        for name in weights:
            if name not in known and ":" not in name:
                there = ", ".join(known)
                raise EchoAvatarError(f"no reward {name!r}; there are {there}, or name your own as module:function")
        self._functions = {name: known[name] if name in known else imported(name, "reward") for name in weights}

    def __call__(self, motions: Sequence[DecodedMotion]) -> Rewards:
        """Rewards of motions.

        Raises EchoAvatarError if a function returned a value that is not finite or has the wrong length.
        """
        tokens = np.zeros((len(motions), motions[0].frames // FRAMES_PER_MOTION_TOKEN))
        whole, parts = np.zeros(len(motions)), {}
        for name, function in self._functions.items():
            values = np.stack([self._checked(name, function, motion, row) for row, motion in enumerate(motions)])
            parts[name] = values if values.ndim == 1 else values.sum(1)
            if values.ndim == 1:
                whole += self.weights[name] * values
            else:
                tokens += self.weights[name] * values
        return Rewards(tokens, whole, parts)

    def _checked(self, name: str, function: Reward, motion: DecodedMotion, row: int) -> Float[np.ndarray, "*n"]:
        assert self.reference_statistics is not None
        value = np.asarray(function(motion, self.reference_statistics), np.float64)
        if not np.isfinite(value).all():
            raise EchoAvatarError(
                f"reward {name!r} is {value[~np.isfinite(value)].flat[0] if value.ndim else value} for continuation"
                f" {row}; it must be a finite number for every motion: fix the function or leave it out"
            )
        if value.ndim == 0:
            return value
        if value.shape != (motion.frames,):
            raise EchoAvatarError(
                f"reward {name!r} has shape {value.shape}; it must be a number, or one for each of the"
                f" {motion.frames} new frames"
            )
        return np.asarray(value.reshape(-1, FRAMES_PER_MOTION_TOKEN).sum(1))


def parse_weights(words: Sequence[str], what: str = "reward", example: str = "stillness=0.5") -> dict[str, float]:
    """`trunk=1 stillness=0.5` as weights; of rewards, `module:function` names a function of your own.

    Raises EchoAvatarError if a word is not NAME=WEIGHT.
    """
    weights = {}
    for word in words:
        name, _, weight = word.rpartition("=")
        try:
            weights[name] = float(weight)
        except ValueError as error:
            raise EchoAvatarError(f"{what} {word!r} is not NAME=WEIGHT, such as {example}") from error
        if not name:
            raise EchoAvatarError(f"{what} {word!r} has no name; write for example {example}")
    return weights


def imported(name: str, what: str) -> Any:
    """The object that `module:name` names. Raises EchoAvatarError if there is no such object."""
    module, _, attribute = name.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise EchoAvatarError(f"{what} {name!r} cannot be imported ({error}); is its module on PYTHONPATH?") from error
