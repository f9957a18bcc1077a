"""Weights of rewards that follow targets: a weight grows while the mean of what it pays is short of its target.

So one run can keep many rows at once: what is met costs nothing, and what is short is paid for. It is the method of
multipliers with a weight between two bounds.
"""

import math
from collections.abc import Mapping

from pydantic import Field

from echoavatar.config import Config

GAIN = 0.1  # of the log weight, for a mean that is short by all of its target
MOST_SHORT = 0.4  # of the target; what is further off is not paid faster
MEMORY = 0.7  # share of the earlier mean in a new one


class Target(Config):
    """What a mean should be, and between which bounds its weight may move."""

    aim: float = Field(gt=0, description="wanted mean")
    is_least: bool = Field(default=True, description="whether the mean should be at least, not at most, `aim`")
    weight: float = Field(gt=0, description="weight at the start")
    low: float = Field(gt=0, description="smallest weight")
    high: float = Field(gt=0, description="largest weight")

    @property
    def sign(self) -> float:
        """1 where more is wanted, -1 where less is."""
        return 1.0 if self.is_least else -1.0


class Weights:
    """The weights of all targets by name."""

    def __init__(self, targets: Mapping[str, Target]) -> None:
        self.targets = dict(targets)
        self.values = {name: target.weight for name, target in targets.items()}
        self.means: dict[str, float] = {}

    def see(self, name: str, mean: float) -> None:
        """Move the weight of a target after a batch with this mean; a mean that is not finite changes nothing."""
        if not math.isfinite(mean):
            return
        target = self.targets[name]
        self.means[name] = MEMORY * self.means.get(name, mean) + (1 - MEMORY) * mean
        short = target.sign * (target.aim - self.means[name]) / target.aim
        moved = self.values[name] * math.exp(GAIN * min(MOST_SHORT, max(-MOST_SHORT, short)))
        self.values[name] = min(target.high, max(target.low, moved))
