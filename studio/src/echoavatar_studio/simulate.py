"""Simulated raters: they answer with known preferences and some noise, through the same functions as people.

They fill the demo, and test that a study recovers the preferences of its raters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from sqlalchemy import select

from .joining import agree, join
from .judging import judge, next_task
from .owner_actions import OwnerActions
from .secrecy import new_name
from .sessions import Visitor, find_visitor
from .store import Store
from .tables import Clip, Sound, Study, System, Task, Trial
from .wire import Question
from .wire_owner import Invite
from .wire_rater import Answer, PairwiseAnswer, PreferenceAnswer, RaterTask, SkipAnswer

CORRUPTED = -4.0  # the worth of a clip that is plainly broken


@dataclass(frozen=True)
class Preferences:
    """Preferences of simulated raters: a rating is the difference of two worths plus noise, rounded, within [-2, 2]."""

    worth: Mapping[str, float]  # by system
    noise: float = 0.8
    of_question: Mapping[Question, float] | None = None  # factor on differences of worth, 1 if absent
    skips: float = 0.05  # preference: share of skips
    careless: float = 0.0  # share of random answers


class SimulatedRaters:
    """Draws answers; unlike people it knows the design."""

    def __init__(self, store: Store, study: str, preferences: Preferences, seed: int) -> None:
        self._store, self._preferences, self._random = store, preferences, np.random.default_rng([seed, 7])
        with store.read() as session:
            row = session.scalars(select(Study).where(Study.public == study)).one()
            names: dict[int, str] = dict(
                session.execute(
                    select(Clip.id, System.name)
                    .join(System, Clip.system_id == System.id)
                    .where(Clip.study_id == row.id)
                ).all()
            )
            found = session.execute(
                select(Task.public, Task.order, Trial.clips, Sound.category)
                .join(Trial, Task.trial_id == Trial.id)
                .join(Sound, Trial.sound_id == Sound.id)
                .where(Trial.study_id == row.id)
            )
            self._clips = {public: [clips[place] for place in order] for public, order, clips, _ in found}
        self._names = names
        # candidates of one model differ, too: each has a worth of its own, the same for all raters
        own = np.random.default_rng([seed, 8])
        self._worth = {clip: preferences.worth.get(name, 0.0) + own.normal(0, 0.3) for clip, name in names.items()}
        self._is_pairwise = row.kind == "pairwise"

    def work(self, visitor: Visitor, questions: tuple[Question, ...], *, tasks: int | None = None) -> int:
        """Let one rater answer a number of tasks (None: all); return how many were answered."""
        done = 0
        while tasks is None or done < tasks:
            task = next_task(self._store, visitor).task
            if task is None:
                break
            judge(self._store, visitor, task.id, new_name(), self._answer(task, questions))
            done += 1
        return done

    def _answer(self, task: RaterTask, questions: tuple[Question, ...]) -> Answer:
        random, preferences, clips = self._random, self._preferences, self._clips[task.id]
        plays = tuple(int(1 + random.poisson(0.4)) for _ in clips)
        seconds = round(float(task.seconds * sum(plays) + random.gamma(4, 1.5)), 2)
        is_careless = random.random() < preferences.careless
        if self._is_pairwise:
            ratings = self._by_lot(questions) if is_careless else self._ratings(clips, questions)
            return PairwiseAnswer(ratings=ratings, seconds=seconds, plays=plays)
        if random.random() < preferences.skips:
            return SkipAnswer(reason="no_difference", seconds=seconds, plays=plays)
        worth = np.array([self._worth.get(clip, CORRUPTED) for clip in clips])
        seen = (0 if is_careless else worth) + random.normal(0, preferences.noise * 0.4, len(clips))
        return PreferenceAnswer(best=int(seen.argmax()), worst=int(seen.argmin()), seconds=seconds, plays=plays)

    def _by_lot(self, questions: tuple[Question, ...]) -> dict[Question, int]:
        return {question: int(self._random.integers(-2, 3)) for question in questions}

    def _ratings(self, clips: list[int], questions: tuple[Question, ...]) -> dict[Question, int]:
        """Ratings towards the second clip, from the systems' worths alone: the preferences to recover are exact."""
        factor, is_same = self._preferences.of_question or {}, clips[0] == clips[1]
        one, other = (
            self._preferences.worth[self._names[clip]] if clip in self._names else CORRUPTED for clip in clips
        )
        noise = self._random.normal(0, 0.2 if is_same else self._preferences.noise, len(questions))
        means = [(other - one) * factor.get(question, 1.0) for question in questions]
        return {
            question: int(np.clip(np.rint(mean + off), -2, 2))
            for question, mean, off in zip(questions, means, noise, strict=True)
        }


def simulate(
    store: Store,
    actions: OwnerActions,
    study: str,
    preferences: Preferences,
    *,
    raters: int,
    seed: int,
    last: int | None = None,
) -> int:
    """Let raters join by personal invitations and do all tasks (the last rater `last`); return the answers given."""
    simulated = SimulatedRaters(store, study, preferences, seed)
    invited = actions.invite(study, Invite(count=raters, label="made up"), page="")
    done = 0
    for number, link in enumerate(invited.links):
        cookie, joined = join(store, link.url.lstrip("#"), None, page="")
        visitor = find_visitor(store, cookie)
        assert visitor is not None
        agree(store, visitor)
        done += simulated.work(visitor, joined.study.questions, tasks=last if number == raters - 1 else None)
    return done
