"""The targets that the default bundle's generator was tuned with: shares of what another generator measures.

A tuned generator keeps time, dances and talks as much as the one before it (`like`), and is told from people less.
Its own measurements are the only ones that are comparable: windows here are shorter than those of `evaluate`.
"""

from collections.abc import Mapping
from typing import NamedTuple

from pydantic import Field

from echoavatar.config import Config

from .targets import Target

LEAST = 1e-3  # of an aim: a generator that has not learnt to keep time may hit less than chance
TOLD_APART = 0.8  # by the opponent, which has seen hundreds of such windows: `evaluate BUNDLE alive` tells fewer


class Goal(NamedTuple):
    """A share of what the other generator measures, and how much it may weigh."""

    share: float
    weight: float
    low: float
    high: float
    is_least: bool = True

    def target(self, measured: float) -> Target:
        """The target, given the other generator's mean."""
        aim = max(LEAST, self.share * measured)
        return Target(aim=aim, is_least=self.is_least, weight=self.weight, low=self.low, high=self.high)


GOALS = {
    "music.beats": Goal(0.95, 3.0, 1.0, 10.0),
    "speech.stresses": Goal(0.95, 1.5, 0.5, 6.0),
    "music.jerk": Goal(0.88, 0.05, 0.005, 0.6, is_least=False),
    "speech.jerk": Goal(1.0, 0.03, 0.003, 0.4, is_least=False),
    "music.hands_still": Goal(1.0, 0.03, 0.003, 0.3, is_least=False),
    "music.trunk_lean": Goal(1.0, 0.03, 0.002, 0.4),
    "music.shoulder_turn": Goal(1.03, 0.03, 0.002, 0.4),
    "music.hip_sway": Goal(0.9, 0.02, 0.002, 0.3),
    "speech.room": Goal(0.95, 0.02, 0.002, 0.3),
    "speech.trunk_lean": Goal(1.0, 0.02, 0.002, 0.3),
    "speech.hip_sway": Goal(0.9, 0.01, 0.001, 0.3),
    "speech.hand_speed": Goal(0.85, 0.01, 0.001, 0.3),
    "speech.ankle_speed": Goal(0.8, 0.01, 0.001, 0.2),
    "rest": Goal(1.1, 0.03, 0.003, 0.5, is_least=False),
}


class Targets(Config):
    """The targets of a run, as they are kept beside it."""

    targets: dict[str, Target] = Field(description="targets by name")


def targets_like(means: Mapping[str, float]) -> dict[str, Target]:
    """Targets from another generator's means (`judge.means_of`).

    Raises:
        KeyError: its continuations were not of both kinds of sound.
    """
    told = {
        "music.told_apart": Target(aim=TOLD_APART, is_least=False, weight=0.12, low=0.03, high=0.5),
        "speech.told_apart": Target(aim=TOLD_APART, is_least=False, weight=0.04, low=0.01, high=0.2),
    }
    return told | {name: goal.target(means[name]) for name, goal in GOALS.items()}
