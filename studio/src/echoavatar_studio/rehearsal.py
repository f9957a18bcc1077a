"""A study from end to end with made-up raters: made, judged, checked and evaluated. It says nothing about motion.

It shows whether the design finds known preferences: raters prefer the systems in the order of the settings, and motion
to its own sound over mismatched motion. Every eighth rater answers at random. Raters that fail an attention check are
excluded, as in GENEA, and no other rater takes over their tasks.
"""

from pathlib import Path
from typing import NamedTuple

from .making import Maker
from .owner_actions import OwnerActions
from .quality import rater_rows
from .results import results
from .settings import PairwiseStudy
from .simulate import Preferences, simulate
from .wire import Question

STEP, MISMATCH, NOISE = 0.4, 0.8, 0.6
CARELESS_EVERY = 8


class Found(NamedTuple):
    """What raters were made to prefer in a pair, and what the study says."""

    first: str
    second: str
    category: str
    question: Question
    gap: float  # made-up worth of the first minus that of the second
    mean: float
    half: float | None  # of the 95 % interval over raters

    @property
    def is_right(self) -> bool:
        """Whether the study finds a preference, and the right one."""
        return self.half is not None and abs(self.mean) > self.half and (self.mean > 0) == (self.gap > 0)


def made_up_worth(settings: PairwiseStudy) -> dict[str, float]:
    """Worth of each system: less from one to the next, and less for mismatched motion than for its own."""
    made = [system.name for system in settings.systems if system.mismatched is None]
    worth = {name: -STEP * place for place, name in enumerate(made)}
    return worth | {s.name: worth[s.mismatched] - MISMATCH for s in settings.systems if s.mismatched is not None}


def rehearse_study(maker: Maker, settings: PairwiseStudy, base: Path) -> tuple[str, list[Found]]:
    """Make the study and judge it; returns its public name and what each pair's means say.

    Raises:
        EchoAvatarError: a sound, model or clip cannot be used.
    """
    public = maker.begin(settings, by="studio")
    maker.make(public, settings, base)
    actions, worth = OwnerActions(maker, "studio"), made_up_worth(settings)
    careless = settings.raters // CARELESS_EVERY
    for count, share, seed in ((settings.raters - careless, 0.0, 1), (careless, 1.0, 2)):
        if count:
            made_up = Preferences(worth=worth, noise=NOISE, careless=share)
            simulate(maker.store, actions, public, made_up, raters=count, seed=settings.seed + seed)
    for row in rater_rows(maker.store, public).raters:
        if row.checks_failed:
            actions.exclude(public, row.id, is_excluded=True, reason="failed an attention check")
    rows = results(maker.store, public).pairs
    return public, [
        Found(
            *(row.first, row.second, row.category, question),
            worth[row.first] - worth[row.second],
            *(score.mean, score.half_raters),
        )
        for row in rows
        for question, score in row.scores.items()
    ]


def as_text(found: list[Found]) -> str:
    """A line for each pair and question."""
    lines = ["made-up raters: this shows whether the design works, and nothing about the systems"]
    for one in found:
        half = "-" if one.half is None else f"{one.half:.2f}"
        says = "found" if one.is_right else "not found"
        lines.append(
            f"{one.first} over {one.second}, {one.category}, {one.question}:"
            f" made up {one.gap:+.2f}, mean {one.mean:+.2f} +- {half}, {says}"
        )
    return "\n".join([*lines, f"{sum(one.is_right for one in found)} of {len(found)} preferences found"])
