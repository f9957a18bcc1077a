"""A classifier that learns along: how surely is a window of motion a person's rather than this policy's?

The realism reward of `align` is fitted once. This one is fitted again to the policy's latest windows every
few batches, as the discriminator of an adversarial network is, so that no trick against one classifier pays for long.
That needs hundreds of windows a batch: with a hundred it brought less than the fixed one.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from echoavatar_lab.align.realism import MOST
from echoavatar_lab.evaluation.metrics.distributions import Classifier, fit
from echoavatar_lab.evaluation.metrics.liveliness import STATISTICS

KEPT = 1500  # of the policy's windows
FEWEST = 60  # of the policy's windows before the first fit
EVERY = 3  # batches between fits
COUNT = len(STATISTICS)


class Opponent:
    """The classifier of one kind of sound."""

    def __init__(self, people: Float[np.ndarray, "n 9"]) -> None:
        """`people` are the statistics of people's windows."""
        self.people, self.own = people, np.zeros((0, COUNT))
        self._classifier: Classifier | None = None
        self._batches = 0

    def see(self, windows: Float[np.ndarray, "m 9"]) -> float | None:
        """Learn from a batch; returns how surely the classifier of before tells it from people, 0.5 to 1."""
        accuracy = None
        if self._classifier is not None and len(windows):
            is_told = (
                (self._classifier.log_odds(windows) > 0).mean(),
                (self._classifier.log_odds(self.people) <= 0).mean(),
            )
            accuracy = float(np.mean(is_told))
        self.own = np.concatenate([self.own, windows])[-KEPT:]
        if self._batches % EVERY == 0:
            self._fit()
        self._batches += 1
        return accuracy

    def _fit(self) -> None:
        if len(self.own) >= FEWEST:
            sides = np.concatenate([self.own, self.people])
            self._classifier = fit(sides, np.repeat([1.0, 0.0], [len(self.own), len(self.people)]))

    def odds(self, windows: Float[np.ndarray, "m 9"]) -> Float[np.ndarray, " m"]:
        """Log odds that windows are a person's, within -4 and 4; 0 before the first fit."""
        if self._classifier is None:
            return np.zeros(len(windows))
        return np.asarray(np.clip(-self._classifier.log_odds(windows), -MOST, MOST))

    def state(self) -> dict[str, np.ndarray]:
        """Everything that `load_state` needs."""
        fitted = {} if self._classifier is None else self._classifier._asdict()
        return {"own": self.own, "batches": np.array(self._batches)} | fitted

    def load_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on where `state` was taken."""
        fitted = {name: value for name, value in state.items() if name not in ("own", "batches")}
        self.own, self._batches = state["own"], int(state["batches"])
        self._classifier = Classifier(**fitted) if fitted else None
