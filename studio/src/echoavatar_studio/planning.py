"""From clips to tasks: trials, attention checks, practice, and the blocks of raters."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from sqlalchemy.orm import Session

from .design import Sides, blocks, spread
from .secrecy import new_name
from .settings import PairwiseStudy, PreferenceStudy
from .tables import Block, Study, Task, Trial


class Item(NamedTuple):
    """The clips for one sound: those of the systems (or the candidates), and a corrupted one."""

    sound_id: int
    name: str
    clips: Mapping[str, int]  # by system, or by number of candidate
    corrupted: int


Add = Callable[[Item, str, Sequence[int]], Trial]  # a trial of an item: its role and its clips


def plan(session: Session, study: Study, settings: PairwiseStudy | PreferenceStudy, items: Sequence[Item]) -> int:
    """Write trials, blocks and tasks; return the number of tasks that count."""

    def add(item: Item, role: str, clips: Sequence[int]) -> Trial:
        trial = Trial(study_id=study.id, sound_id=item.sound_id, role=role, clips=list(clips))
        session.add(trial)
        session.flush()
        return trial

    real, groups = _real(add, settings, items)
    identical = _identical(add, items) if settings.kind == "pairwise" else []
    corrupted = [_corrupted_trial(add, settings, item, "corrupted", k) for k, item in enumerate(items)]
    practice = [_corrupted_trial(add, settings, item, "training", k + 1) for k, item in enumerate(items)]
    random = np.random.default_rng([settings.seed, 5])

    def some(of: Sequence[Trial], count: int) -> list[Trial]:
        return [of[int(at)] for at in random.permutation(len(of))[:count]]

    sides = Sides(settings.seed)
    rows = blocks(groups, count=settings.raters, size=settings.tasks_per_rater, seed=settings.seed)
    for number, row in enumerate(rows):
        checks = some(identical, settings.checks.identical) + some(corrupted, settings.checks.corrupted)
        extra = [checks[int(at)] for at in random.permutation(len(checks))]
        known = {trial.id: trial for trial in (*real, *extra)}
        order = spread([real[at].id for at in row], [trial.id for trial in extra], [settings.seed, number])
        everything = some(practice, settings.training) + [known[one] for one in order]
        block = Block(study_id=study.id, number=number + 1)
        session.add(block)
        session.flush()
        for position, trial in enumerate(everything):
            shown = sides.pair(trial.id, number) if len(trial.clips) == 2 else sides.many(trial.id, len(trial.clips))
            session.add(
                Task(
                    public=new_name(),
                    block_id=block.id,
                    trial_id=trial.id,
                    position=position,
                    order=list(shown.order),
                    first=shown.first,
                )
            )
        session.flush()
    return sum(len(row) for row in rows)


def _real(
    add: Add, settings: PairwiseStudy | PreferenceStudy, items: Sequence[Item]
) -> tuple[list[Trial], list[list[str]]]:
    """The trials that count, with the marks of each: the sound, and in pairwise studies the pair and both systems."""
    found, groups = [], []
    for item in items:
        if settings.kind == "preference":
            found.append(add(item, "real", list(item.clips.values())))
            groups.append([f"sound {item.name.rsplit(' @', 1)[0]}"])
            continue
        for one, other in combinations(settings.systems, 2):
            if one.group == other.group:
                found.append(add(item, "real", [item.clips[one.name], item.clips[other.name]]))
                groups.append([f"sound {item.name}", f"pair {one.name} {other.name}", one.name, other.name])
    return found, groups


def _identical(add: Add, items: Sequence[Item]) -> list[Trial]:
    found = []
    for number, item in enumerate(items):
        clips = list(item.clips.values())
        found.append(add(item, "identical", [clips[number % len(clips)]] * 2))
    return found


def _corrupted_trial(add: Add, settings: PairwiseStudy | PreferenceStudy, item: Item, role: str, number: int) -> Trial:
    """A check with an intact clip and a corrupted one; in preference studies the corrupted clip replaces a candidate.

    The corrupted clip always has the last place, by which `quality` recognises it.
    """
    clips = list(item.clips.values())
    if settings.kind == "pairwise":
        return add(item, role, [clips[number % len(clips)], item.corrupted])
    return add(item, role, [*clips[:-1], item.corrupted])
