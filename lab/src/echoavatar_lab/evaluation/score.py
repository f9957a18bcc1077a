"""`echoavatar score`: generated against true motion and the audio, every metric of the research bench in one table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.ik.measure import penetration_depth_m
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.contact import planted, skate
from echoavatar.timing import FRAME_RATE_HZ

from .metrics.bootstrap import Interval, interval
from .metrics.diversity import l1_deviation
from .metrics.frechet import Moments, frechet_between, moments, pooled
from .metrics.motion_features import motion_features
from .metrics.physical import floor_depth_cm, foot_contact_score, jerk_m_s3
from .motion_folder import Pair
from .reconstruction import Reconstruction, reconstruction
from .score_beats import ClipAudio, dance_rows, gesture_rows
from .score_liveliness import liveliness_rows
from .score_row import Row, row_of_means

FID_SAMPLES = 300
MIN_FRAMES = 8
Progress = Callable[[int, int], None]
_BALLS = list(HUMANOID.config.feet)[1::2]  # the ankle may swing over a planted ball; the ball must not move
_STANDING = HUMANOID.rest_positions[_BALLS, 1].numpy()


UNITS = {
    "l1_diversity": "m",
    "skate": "cm/s",
    "floor_depth": "cm",
    "hand_depth": "mm",
    "jerk": "m/s3",
    "foot_contact_score": "",
}


@runtime_checkable
class Extractor(Protocol):
    """A feature extractor for FID."""

    def features(self, clip: Float[torch.Tensor, "t c"]) -> Float[torch.Tensor, "n d"]:
        """Latents of a clip of `motion_features`."""


@dataclass(frozen=True)
class ClipMeasurements:
    """Measurements of one clip that need no counterpart."""

    positions: Float[np.ndarray, "t j 3"]
    planted: float  # number of planted foot frames, the weight of the skate
    numbers: dict[str, float]  # by the names of `UNITS`
    latents: Moments | None


def score(
    pairs: Sequence[Pair], extractor: Extractor | None, *, seed: int = 0, progress: Progress | None = None
) -> list[Row]:
    """All rows; without audio those that need it are left out, without an extractor FID.

    Raises:
        MotionError: there is no clip, or one is too short.
    """
    if not pairs:
        raise MotionError("there is no clip to score; give folders with motion")
    made, true = [], []
    for done, pair in enumerate(pairs, 1):
        if pair.made.frames < MIN_FRAMES:
            raise MotionError(f"clip {pair.name} has {pair.made.frames} frames, scores need {MIN_FRAMES}; leave it out")
        made.append(measure_clip(pair.made, extractor))
        true.append(measure_clip(pair.true, extractor))
        if progress is not None:
            progress(done, len(pairs))
    latents = [[clip.latents for clip in side if clip.latents] for side in (made, true)]
    rows = [fid_row(*latents, seed=seed)] if extractor else []
    if all(pair.audio is not None for pair in pairs):
        heard = [ClipAudio(pair.audio, pair.domain) for pair in pairs if pair.audio is not None]
        places, truths = [clip.positions for clip in made], [clip.positions for clip in true]
        rows += gesture_rows(heard, places, truths, seed=seed) + dance_rows(heard, places, truths, seed=seed)
    weights = np.array([pair.made.frames for pair in pairs], float)
    for name, unit in UNITS.items():
        values, others = (np.array([clip.numbers[name] for clip in side]) for side in (made, true))
        own = np.array([clip.planted for clip in made]) if name == "skate" else weights
        row = row_of_means(name, unit, values, weights=own, seed=seed)
        own = np.array([clip.planted for clip in true]) if name == "skate" else weights
        rows.append(row._replace(truth=row_of_means(name, unit, others, weights=own).value))
    rows += liveliness_rows(pairs, seed=seed)
    errors = np.array([_errors(pair) for pair in pairs]).T
    for name, unit, column in zip(
        ("mpjpe_body", "mpjpe_hands", "trans_loss"), ("mm", "mm", "mm/frame"), errors, strict=True
    ):
        rows.append(row_of_means(name, unit, column, weights=weights, seed=seed))
    return rows


def measure_clip(motion: Motion, extractor: Extractor | None = None) -> ClipMeasurements:
    """Measure one clip on our rig at 30 fps."""
    positions = motion.pose().positions.numpy().astype(np.float64)
    balls = positions[:, _BALLS]
    above = balls - np.array([0.0, 1.0, 0.0]) * _STANDING[:, None]
    depth = penetration_depth_m(HUMANOID, motion.matrices())
    rotations, root = torch.from_numpy(motion.rotations), torch.from_numpy(motion.root)
    return ClipMeasurements(
        positions,
        float(planted(balls, FRAME_RATE_HZ, standing_height=_STANDING).sum()),
        {
            "l1_diversity": l1_deviation(positions - positions[:, :1]),
            "skate": skate(balls, FRAME_RATE_HZ, standing_height=_STANDING),
            "floor_depth": floor_depth_cm(above),
            "hand_depth": float(depth.mean() * 1000),
            "jerk": jerk_m_s3(positions),
            "foot_contact_score": foot_contact_score(positions, HUMANOID.config.feet),
        },
        moments(extractor.features(motion_features(rotations, root)).numpy()) if extractor else None,
    )


def fid_row(ours: Sequence[Moments], theirs: Sequence[Moments], *, seed: int = 0) -> Row:
    """FID with its interval over clips drawn jointly on both sides; `truth` compares two halves of the true clips."""

    def distance(clips: Sequence[int] | np.ndarray) -> float:
        return frechet_between(pooled([ours[k] for k in clips]), pooled([theirs[k] for k in clips]))

    ends = interval(distance, len(ours), is_centred=True, samples=FID_SAMPLES, seed=seed)
    ends = Interval(max(ends.low, 0.0), ends.high) if ends.low < 0 else ends  # centring can shift it below zero
    row = Row("fid", "", distance(range(len(ours))), ends)
    if len(theirs) < 2:
        return row
    return row._replace(truth=frechet_between(pooled(theirs[::2]), pooled(theirs[1::2])))


def _errors(pair: Pair) -> Reconstruction:
    steps = [
        torch.from_numpy(np.diff(m.root[:, [0, 2]], axis=0, prepend=m.root[:1, [0, 2]])) for m in (pair.true, pair.made)
    ]
    return reconstruction(HUMANOID, pair.true.matrices(), pair.made.matrices(), *steps)
