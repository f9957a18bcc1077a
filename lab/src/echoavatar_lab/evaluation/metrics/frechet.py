"""FID: the Fréchet distance between Gaussians fitted to features of generated and of true motion (paper, appendix).

    ||mu_r - mu_g||^2 + Tr(S_r + S_g - 2 (S_r S_g)^(1/2)),   S with n - 1 in the denominator

In squared units of the features, 0 and up. The trace of the root comes from the eigenvalues of S_g^(1/2) S_r S_g^(1/2),
which is symmetric: no complex matrix root is needed, and the result is exact with fewer samples than features.

EMAGE's evaluation tools always add 1e-6 to both covariances inside the root (`ridge=1e-6`); others add it only when
their root fails. The value depends on the extractor and falls as samples grow, so compare only values of one extractor
and one test set with about equal amounts of motion. EMAGE's table prints tenths: 5.512 is 0.5512.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError


class Moments(NamedTuple):
    """Number, mean and scatter of a clip's features: all that a Fréchet distance needs; moments can be pooled."""

    rows: int
    mean: Float[np.ndarray, " d"]
    scatter: Float[np.ndarray, "d d"]  # sum of squares about the mean

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance with n - 1 in the denominator."""
        return np.asarray(self.scatter / (self.rows - 1))


def moments(features: Float[np.ndarray, "n d"]) -> Moments:
    """Moments of one clip's features.

    Raises:
        MotionError: a feature is not finite.
    """
    values = np.asarray(features, np.float64)
    if not np.isfinite(values).all():
        raise MotionError("features hold values that are not finite; leave out the clip or repair its motion")
    mean = values.mean(0) if len(values) else np.zeros(values.shape[1])
    centred = values - mean
    return Moments(len(values), mean, centred.T @ centred)


def pooled(parts: Sequence[Moments]) -> Moments:
    """Moments of all clips together."""
    count = sum(part.rows for part in parts)
    mean = sum(part.rows * part.mean for part in parts) / max(count, 1)
    scatter = sum(part.scatter + part.rows * np.outer(part.mean - mean, part.mean - mean) for part in parts)
    return Moments(count, np.asarray(mean), np.asarray(scatter))


def frechet_between(made: Moments, true: Moments, *, ridge: float = 0.0) -> float:
    """Fréchet distance from moments; `ridge` is added to the diagonals inside the root only.

    Raises:
        MotionError: fewer than two features on a side.
    """
    if min(made.rows, true.rows) < 2:
        raise MotionError(f"FID needs two features a side, got {made.rows} and {true.rows}; take longer clips")
    eye = ridge * np.eye(len(made.mean))
    values, vectors = np.linalg.eigh(made.covariance + eye)
    root = (vectors * np.sqrt(values.clip(0))) @ vectors.T
    middle = np.linalg.eigvalsh(root @ (true.covariance + eye) @ root).clip(0)
    shift = made.mean - true.mean
    spread = np.trace(made.covariance) + np.trace(true.covariance) - 2 * np.sqrt(middle).sum()
    return max(0.0, float(shift @ shift + spread))  # rounding alone can make it negative


def frechet_distance(made: Float[np.ndarray, "n d"], true: Float[np.ndarray, "m d"], *, ridge: float = 0.0) -> float:
    """Fréchet distance between two sets of features."""
    return frechet_between(moments(made), moments(true), ridge=ridge)


def scaled_by_truth(
    made: Float[np.ndarray, "n d"], true: Float[np.ndarray, "m d"]
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "m d"]]:
    """Scale both sets by the truth's mean and (population) deviation, as Bailando does for FID_k and FID_m."""
    mean, spread = true.mean(0), true.std(0) + 1e-10
    return (made - mean) / spread, (true - mean) / spread
