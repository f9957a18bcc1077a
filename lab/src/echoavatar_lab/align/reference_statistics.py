"""Reference statistics: how true motion responds to beats and stressed syllables, how fast and how smooth it is.

Timing rewards are matched filters. Take the speed of the body around every beat (of the arms around every stressed
syllable) in true motion, divided by its mean over the motion. Its mean over events, minus its own mean over time, is
the profile P. The response of a generated motion u to one event is

    sum_t u(t) P(t - event) / sum_t P(t)^2

It is 1 where motion responds like the truth on average, and 0 on average where motion ignores the event. P sums to
zero, so chance is already subtracted, and neither standing still nor moving more raises it. This reward is ours; the
paper's alignment reward is the learned embedding in `audio_reward`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Self

import numpy as np
from jaxtyping import Float
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import CheckpointError, MotionError
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.evaluation.metrics.beat_alignment import ARM_JOINTS
from echoavatar_lab.evaluation.metrics.liveliness import yaw
from echoavatar_lab.evaluation.metrics.positions import jerk_m_s3

from .decoded_motion import DecodedMotion

BEFORE, AFTER = 8, 12  # frames of the profile before and after an event
STILL_M_S = 0.03  # added to the mean speed, so that a body at rest shows no response
HIGHEST = 2.0  # limits the weight of a single stroke in otherwise quiet motion
FEWEST_EVENTS = 20
Kind = Literal["beat", "stress"]


Movement = tuple[float, float, float, float]


class ReferenceStatistics(Config):
    """Measured once, on the true motion of the training clips."""

    beat: tuple[float, ...] = Field(description="profile of the body's speed around beats, frame by frame")
    stress: tuple[float, ...] = Field(description="profile of the arms' speed around stressed syllables")
    speed: tuple[float, float, float] = Field(description="mean speed (m/s) in silence, speech, music")
    movement: tuple[Movement, Movement, Movement] = Field(description="mean of `body_movement` in the same domains")
    jerk: float = Field(gt=0, description="mean jerk, m/s3")
    scenes: int = Field(gt=0, description="number of motions measured")

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote.

        Raises:
            CheckpointError: the file is missing or holds something else.
        """
        try:
            return cls.model_validate_json(path.read_bytes())
        except (OSError, ValidationError) as error:
            raise CheckpointError(
                f"{path} holds no reference statistics; let `echoavatar align grpo` measure them again"
            ) from error

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")


def measure_reference_statistics(scenes: Sequence[DecodedMotion]) -> ReferenceStatistics:
    """Profiles and mean levels of true motion.

    Raises:
        MotionError: there are too few beats and stresses.
    """
    profiles = {}
    for kind in ("beat", "stress"):
        around = [part for motion in scenes for part in _around(motion, kind)]
        if len(around) < FEWEST_EVENTS:
            around = []
        mean = np.mean(around, 0) if around else np.zeros(BEFORE + AFTER + 1)
        profiles[kind] = tuple(float(value) for value in mean - mean.mean())
    if not any(any(profile) for profile in profiles.values()):
        raise MotionError(
            f"{len(scenes)} prompts hold fewer than {FEWEST_EVENTS} beats and stresses; tokenize a corpus that has"
            " event labels (`data rehearse`, `data prepare`)"
        )
    speeds = np.concatenate([motion.speed() for motion in scenes])
    domains = np.concatenate([motion.domain[motion.lead :] for motion in scenes])
    level = [float(speeds[domains == d].mean()) if (domains == d).any() else 0.0 for d in range(3)]
    moved = np.concatenate([body_movement(motion) for motion in scenes])
    movement = [moved[domains == d].mean(0) if (domains == d).any() else np.zeros(4) for d in range(3)]
    jerk = float(np.mean([jerk_m_s3(motion.positions) for motion in scenes]))
    return ReferenceStatistics(
        beat=profiles["beat"],
        stress=profiles["stress"],
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


def relative_speed(motion: DecodedMotion, kind: Kind) -> Float[np.ndarray, " t"]:
    """Speed over its mean, minus 1, at most `HIGHEST`: of the whole body for beats, of the arms for stresses."""
    speed = motion.speed(None if kind == "beat" else motion.skeleton.indices(ARM_JOINTS))
    relative = (speed - speed.mean()) / (speed.mean() + STILL_M_S)
    return np.asarray(np.minimum(relative, HIGHEST))


def event_frames(motion: DecodedMotion, kind: Kind) -> list[int]:
    """Frames of the events whose whole profile lies within the new frames."""
    times = motion.beats if kind == "beat" else motion.stresses
    at = np.round(times * FRAME_RATE_HZ).astype(int)
    return [int(k) for k in at if k >= BEFORE and k + AFTER < motion.frames]


def _around(motion: DecodedMotion, kind: Literal["beat", "stress"] | str) -> list[Float[np.ndarray, " _"]]:
    which: Kind = "beat" if kind == "beat" else "stress"
    u = relative_speed(motion, which)
    return [u[k - BEFORE : k + AFTER + 1] for k in event_frames(motion, which)]


def response(motion: DecodedMotion, kind: Kind, reference_statistics: ReferenceStatistics) -> Float[np.ndarray, " t"]:
    """Response to all events, distributed over the frames that caused it; the sum is the mean over events."""
    profile = np.array(reference_statistics.beat if kind == "beat" else reference_statistics.stress)
    out, frames = np.zeros(motion.frames), event_frames(motion, kind)
    power = float((profile**2).sum())
    if not frames or power == 0:
        return out
    u = relative_speed(motion, kind)
    for k in frames:
        span = slice(k - BEFORE, k + AFTER + 1)
        out[span] += u[span] * profile / power / len(frames)
    return out
