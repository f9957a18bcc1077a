"""Measures motion against the true motion of fixed prompts: FID, diversity, beat alignment minus chance.

These show what a gain in reward costs.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Skeleton, from_features
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar_lab.evaluation.metrics.distributions import Moments, frechet_between, moments, pooled
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder, motion_features
from echoavatar_lab.evaluation.metrics.positions import l1_deviation

from .decoded_motion import DecodedMotion, decode_truth
from .prompts import Prompt
from .reference_statistics import ReferenceStatistics
from .rewards import beat_alignment, stress_alignment

TOGETHER = 8  # prompts decoded at once
Measurements = dict[str, object]


class MotionMetrics:
    """Measures motion made for the prompts that this object was built with."""

    def __init__(
        self,
        tokenizer: BodyTokenizer,
        prompts: Sequence[Prompt],
        extractor: MotionEncoder,
        reference_statistics: ReferenceStatistics,
    ) -> None:
        self.truth = [
            motion
            for at in range(0, len(prompts), TOGETHER)
            for motion in decode_truth(tokenizer, prompts[at : at + TOGETHER])
        ]
        self._extractor, self._reference_statistics = extractor, reference_statistics
        self._wanted = self._latents(self.truth)

    def __call__(self, motions: Sequence[DecodedMotion]) -> Measurements:
        """`fid`, `diversity` (m), `beat_alignment` and `stress_alignment`; the last two as mean and standard error."""
        aligned = {
            name: [float(np.sum(score(s, self._reference_statistics))) for s in motions if len(getattr(s, events))]
            for name, events, score in (
                ("beat_alignment", "beats", beat_alignment),
                ("stress_alignment", "stresses", stress_alignment),
            )
        }
        relative = [motion.positions - motion.positions[:, :1] for motion in motions]
        return {
            "fid": frechet_between(self._latents(motions), self._wanted),
            "diversity": float(np.mean([l1_deviation(one) for one in relative])),
            **{name: mean_and_error(np.array(values)) for name, values in aligned.items() if values},
        }

    def _latents(self, motions: Sequence[DecodedMotion]) -> Moments:
        features = torch.from_numpy(np.stack([motion.features for motion in motions]))
        return pooled(feature_moments(self._extractor, motions[0].skeleton, features))


def feature_moments(extractor: MotionEncoder, skeleton: Skeleton, features: Float[Tensor, "b t c"]) -> list[Moments]:
    """Moments of the extractor's latents of each decoded clip."""
    moved = from_features(skeleton, features)
    rotations = quaternion_from_matrix(moved.rotations)
    return [
        moments(extractor.features(motion_features(own, root)).numpy())
        for own, root in zip(rotations, moved.root, strict=True)
    ]


def mean_and_error(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Mean and standard error."""
    error = values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else 0.0
    return round(float(values.mean()), 5), round(float(error), 5)
