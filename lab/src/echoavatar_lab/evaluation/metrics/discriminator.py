"""Can a classifier tell generated motion from captured? Logistic regression on the statistics of windows.

The score is the accuracy on windows of clips that the classifier was not fitted on; both sides weigh the same. 0.5: the
two cannot be told apart; 1: they always can.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FOLDS = 5
RIDGE = 1.0  # weight decay, in windows
_STEPS = 50


def held_out_accuracy(
    made: Float[np.ndarray, "n d"], true: Float[np.ndarray, "m d"], made_clips: Sequence[str], true_clips: Sequence[str]
) -> float:
    """Accuracy over folds that keep the windows of a clip together; NaN if a side has fewer than two clips.

    `made_clips` and `true_clips` name the clip of each row.
    """
    if min(len(set(made_clips)), len(set(true_clips))) < 2:
        return float("nan")
    features, label = np.concatenate([made, true]), np.repeat([1.0, 0.0], [len(made), len(true)])
    folds = [_folds(clips) for clips in (made_clips, true_clips)]
    fold, right = np.concatenate(folds), np.zeros(len(label), bool)
    for number in range(FOLDS):
        held = fold == number
        if held.any():
            right[held] = (fit(features[~held], label[~held]).log_odds(features[held]) > 0) == (label[held] == 1)
    return float((right[label == 1].mean() + right[label == 0].mean()) / 2)


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
    """Fit by Newton's method; `label` is 1 where a window was generated, and both sides weigh the same."""
    mean, spread = features.mean(0), features.std(0) + 1e-9
    rows = _expanded((features - mean) / spread)
    weight = 0.5 / np.where(label == 1, label.mean(), 1 - label.mean())
    decay = RIDGE * np.diag([0.0] + [1.0] * (rows.shape[1] - 1))
    theta = np.zeros(rows.shape[1])
    for _ in range(_STEPS):
        chance = 1 / (1 + np.exp(-(rows @ theta).clip(-30, 30)))
        slope = rows.T @ (weight * (chance - label)) + decay @ theta
        curve = (rows * (weight * chance * (1 - chance))[:, None]).T @ rows + decay + 1e-6 * np.eye(len(theta))
        step = np.linalg.solve(curve, slope)
        theta -= step * min(1.0, 2.0 / (np.linalg.norm(step) + 1e-12))
    return Classifier(mean, spread, theta)


def _expanded(z: np.ndarray) -> np.ndarray:
    z = z.clip(-5, 5)
    return np.concatenate([np.ones((len(z), 1)), z, z**2 - 1], 1)
