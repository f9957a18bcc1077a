"""How far are generated features from true ones, as distributions: Fréchet distance, and a classifier's accuracy.

FID is the Fréchet distance between Gaussians fitted to features of both sides (paper, appendix):

    ||mu_r - mu_g||^2 + Tr(S_r + S_g - 2 (S_r S_g)^(1/2)),   S with n - 1 in the denominator

In squared units of the features, 0 and up. The trace of the root comes from the eigenvalues of S_g^(1/2) S_r S_g^(1/2),
which is symmetric: no complex matrix root is needed, and the result is exact with fewer samples than features.

EMAGE's evaluation tools always add 1e-6 to both covariances inside the root (`ridge=1e-6`); others add it only when
their root fails. The value depends on the extractor and falls as samples grow, so compare only values of one extractor
and one test set with about equal amounts of motion. EMAGE's table prints tenths: 5.512 is 0.5512.

The classifier is a logistic regression on the statistics of windows. Its score is the accuracy on windows of clips that
it was not fitted on; both sides weigh the same. 0.5: the two cannot be told apart; 1: they always can.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

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
    """Moments of one clip's features. Raises MotionError if a feature is not finite."""
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

    Raises MotionError: fewer than two features on a side.
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


FOLDS = 5
QUARTERS = 4  # parts of a lone clip, of which the classifier holds out one after the other
RIDGE = 1.0  # weight decay, in windows

LogOdds = Callable[[np.ndarray], np.ndarray]


def held_out_accuracy(
    made: Float[np.ndarray, "n d"], true: Float[np.ndarray, "m d"], made_clips: Sequence[str], true_clips: Sequence[str]
) -> float:
    """Accuracy over folds that keep the windows of a clip together; NaN if a side has fewer than two clips.

    `made_clips` and `true_clips` name the clip of each row.
    """
    if min(len(set(made_clips)), len(set(true_clips))) < 2:
        return float("nan")
    sides = held_out_right(made, true, made_clips, true_clips)
    return float(np.mean([right.mean() for right in sides]))


def held_out_right(
    made: Float[np.ndarray, "n d"],
    true: Float[np.ndarray, "m d"],
    made_clips: Sequence[str],
    true_clips: Sequence[str],
    *,
    fitted: Callable[[np.ndarray, np.ndarray], LogOdds] | None = None,
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " m"]]:
    """Whether each window of both sides is told rightly, by a classifier fitted without its fold.

    `fitted` fits to features and labels (1: made) and returns the log odds of features; default: `fit`.
    """
    features, label = np.concatenate([made, true]), np.repeat([1.0, 0.0], [len(made), len(true)])
    fold, right = np.concatenate([_folds(clips) for clips in (made_clips, true_clips)]), np.zeros(len(label), bool)
    for number in range(FOLDS):
        held = fold == number
        if held.any():
            known = features[~held], label[~held]
            odds = fitted(*known) if fitted else fit(*known).log_odds
            right[held] = (odds(features[held]) > 0) == (label[held] == 1)
    return right[: len(made)], right[len(made) :]


def parts(clips: Sequence[str]) -> Sequence[str]:
    """The clip of each window; its quarter where there is one clip."""
    return [f"{number * QUARTERS // len(clips)}" for number in range(len(clips))] if len(set(clips)) == 1 else clips


def _folds(clips: Sequence[str]) -> np.ndarray:
    """Deal clips to folds in order; two clips make two folds."""
    order = {clip: number % FOLDS for number, clip in enumerate(dict.fromkeys(clips))}
    return np.array([order[clip] for clip in clips])


class Classifier(NamedTuple):
    """Logistic regression on `d` statistics and their squares."""

    mean: Float[np.ndarray, " d"]
    spread: Float[np.ndarray, " d"]
    weights: Float[np.ndarray, " w"]  # 1 + 2 d: constant, statistics, squares

    def log_odds(self, features: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Log odds that windows were generated; above 0: rather generated."""
        return np.asarray(_expanded((features - self.mean) / self.spread) @ self.weights)


def fit(features: Float[np.ndarray, "n d"], label: Float[np.ndarray, " n"]) -> Classifier:
    """Fit a classifier; `label` is 1 where a window was generated, and both sides weigh the same."""
    from sklearn.linear_model import LogisticRegression  # costs every start of `align` a second

    mean, spread = features.mean(0), features.std(0) + 1e-9
    model = LogisticRegression(C=1 / RIDGE, class_weight="balanced", solver="newton-cholesky", tol=1e-8)
    model.fit(_expanded((features - mean) / spread)[:, 1:], label)
    return Classifier(mean, spread, np.concatenate([model.intercept_, model.coef_[0]]))


def _expanded(z: np.ndarray) -> np.ndarray:
    z = z.clip(-5, 5)
    return np.concatenate([np.ones((len(z), 1)), z, z**2 - 1], 1)
