"""How carefully each rater works: attention checks, speed, uniform answers, agreement with the others."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from sqlalchemy import func, select

from .answers import AnswerRecord, answer_records
from .audit import iso
from .owner_actions import find_study
from .store import Store
from .tables import Block, Invitation, Rater, Task
from .wire_owner import RaterRow, Raters

_TOLERANCE = 1  # largest rating of identical clips that passes
_FEWEST_SHARED = 5  # trials that others rated too; fewer give no agreement


def rater_rows(store: Store, public: str) -> Raters:
    """A row for every rater."""
    with store.read() as session:
        study = find_study(session, public)
        answers = answer_records(session, study)
        sizes: dict[int | None, int] = dict(
            session.execute(
                select(Block.rater_id, func.count(Task.id))
                .join(Task, Task.block_id == Block.id)
                .where(Block.study_id == study.id, Block.rater_id.is_not(None))
                .group_by(Block.rater_id)
            ).all()
        )
        people = session.execute(
            select(Rater, Invitation.label)
            .join(Invitation, Rater.invitation_id == Invitation.id)
            .where(Rater.study_id == study.id)
            .order_by(Rater.number)
        ).all()
    means = _means_without(answers)
    by_rater: dict[int, list[AnswerRecord]] = defaultdict(list)
    for answer in answers:
        by_rater[answer.rater].append(answer)
    return Raters(
        raters=tuple(
            _row(rater, label, by_rater[rater.number], sizes.get(rater.id, 0), means) for rater, label in people
        )
    )


def passes(answer: AnswerRecord) -> bool | None:
    """Whether an attention check was passed; None for other tasks."""
    if answer.role == "identical":
        return not answer.skipped and max(abs(rating) for rating in answer.ratings.values()) <= _TOLERANCE
    if answer.role != "corrupted":
        return None
    if answer.skipped:
        return False
    if answer.worst is not None:
        return answer.worst == len(answer.order) - 1  # the corrupted clip has the last place
    return sum(answer.ratings.values()) > 0


def is_too_fast(answer: AnswerRecord) -> bool:
    """Whether the answer was given in less time than one clip lasts."""
    return answer.seconds < answer.clip_seconds


def _row(
    rater: Rater, label: str, answers: Sequence[AnswerRecord], of: int, means: Mapping[tuple[int, int], float]
) -> RaterRow:
    checks = [passes(answer) for answer in answers]
    seconds = [answer.seconds for answer in answers]
    return RaterRow(
        id=rater.number,
        label=label,
        joined=iso(rater.joined),
        last_seen=iso(rater.seen),
        has_consented=rater.consented is not None,
        done=len(answers),
        of=of,
        checks_passed=checks.count(True),
        checks_failed=checks.count(False),
        skipped=sum(answer.skipped is not None for answer in answers),
        median_seconds=float(np.median(seconds)) if seconds else 0.0,
        too_fast=sum(is_too_fast(answer) for answer in answers),
        straight=_straight(answers),
        agreement=_agreement(answers, means),
        is_excluded=rater.is_excluded,
        reason=rater.reason,
    )


def _straight(answers: Sequence[AnswerRecord]) -> float:
    """The share of the most frequent answer, in terms of positions on the screen."""
    real = [answer for answer in answers if answer.role == "real"]
    if not real:
        return 0.0
    seen = Counter(_on_screen(answer) for answer in real)
    return seen.most_common(1)[0][1] / len(real)


def _on_screen(answer: AnswerRecord) -> tuple[object, ...]:
    if answer.skipped:
        return (answer.skipped,)
    if answer.best is not None and answer.worst is not None:
        return answer.order.index(answer.best), answer.order.index(answer.worst)
    sign = 1 if answer.order[0] == 1 else -1
    return tuple(sign * rating for _, rating in sorted(answer.ratings.items()))


def _means_without(answers: Sequence[AnswerRecord]) -> dict[tuple[int, int], float]:
    """The mean rating of each trial by all other raters, by (trial, rater)."""
    sums: dict[int, list[tuple[int, float]]] = defaultdict(list)
    for answer in answers:
        if answer.role == "real" and answer.ratings and not answer.is_excluded:
            sums[answer.trial].append((answer.rater, float(np.mean(list(answer.ratings.values())))))
    found = {}
    for trial, ratings in sums.items():
        for rater in {answer.rater for answer in answers if answer.trial == trial}:
            others = [value for who, value in ratings if who != rater]
            if others:
                found[trial, rater] = float(np.mean(others))
    return found


def _agreement(answers: Sequence[AnswerRecord], means: Mapping[tuple[int, int], float]) -> float | None:
    pairs = [
        (float(np.mean(list(answer.ratings.values()))), means[answer.trial, answer.rater])
        for answer in answers
        if answer.role == "real" and answer.ratings and (answer.trial, answer.rater) in means
    ]
    if len(pairs) < _FEWEST_SHARED or min(np.std(np.array(pairs), axis=0)) < 1e-9:
        return None
    return float(np.corrcoef(np.array(pairs).T)[0, 1])
