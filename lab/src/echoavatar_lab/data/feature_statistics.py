"""Mean and deviation of the features of clips, by which networks see them normalised."""

from collections.abc import Iterable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

CONSTANT_STD = 1e-4  # a feature with a smaller deviation is held at its mean


class FeatureStatistics(NamedTuple):
    """Mean and standard deviation of each feature; `varies` is False where the deviation is under 1e-4."""

    mean: Float[Tensor, " c"]
    std: Float[Tensor, " c"]
    varies: Bool[Tensor, " c"]

    def normalize(self, features: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
        """Features with zero mean and unit deviation; one that does not vary gives 0, so that noise cannot grow."""
        return torch.where(self.varies, (features - self.mean) / self.std.clamp_min(CONSTANT_STD), 0.0)

    def denormalize(self, normal: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
        """Inverse of `normalize`; features that do not vary come back as their mean."""
        return torch.where(self.varies, normal * self.std, 0.0) + self.mean


def measure_features(clips: Iterable[Float[Tensor, "t c"]]) -> FeatureStatistics:
    """Mean and deviation over all frames of all clips, in double precision, with one clip in memory at a time."""
    count, mean, square = 0, torch.zeros(()), torch.zeros(())
    for clip in clips:
        frames = clip.double()
        new, new_mean = frames.shape[0], frames.mean(0)
        new_square = (frames - new_mean).square().sum(0)
        total = count + new
        shift = new_mean - mean
        square = square + new_square + shift.square() * (count * new / total)
        mean = mean + shift * (new / total)
        count = total
    if not count:
        raise ValueError("there are no clips to measure")
    std = (square / count).sqrt()
    return FeatureStatistics(mean.float(), std.float(), std >= CONSTANT_STD)
