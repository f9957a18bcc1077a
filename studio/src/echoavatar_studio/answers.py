"""The judgements of a study together with their trials: the input of quality checks, results and exports."""

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from .tables import Clip, Judgement, Rater, Sound, Study, System, Task, Trial
from .wire import QUESTIONS


@dataclass(frozen=True)
class AnswerRecord:
    """One judgement."""

    rater: int  # number
    is_excluded: bool
    trial: int
    role: str
    sound: str
    category: str
    systems: tuple[str, ...]  # the systems of the clips, by place; empty: corrupted on purpose
    ratings: Mapping[str, int]  # pairwise: towards place 0
    best: int | None  # preference: places
    worst: int | None
    skipped: str | None
    order: tuple[int, ...]
    first: int
    seconds: float
    clip_seconds: float
    plays: tuple[int, ...]
    at: float


def answer_records(session: Session, study: Study) -> list[AnswerRecord]:
    """All judgements, oldest first."""
    names: dict[int, str] = dict(
        session.execute(
            select(Clip.id, System.name).join(System, Clip.system_id == System.id).where(Clip.study_id == study.id)
        ).all()
    )
    rows = session.execute(
        select(Judgement, Rater, Task, Trial, Sound)
        .join(Rater, Judgement.rater_id == Rater.id)
        .join(Task, Judgement.task_id == Task.id)
        .join(Trial, Task.trial_id == Trial.id)
        .join(Sound, Trial.sound_id == Sound.id)
        .where(Trial.study_id == study.id)
        .order_by(Judgement.at, Judgement.id)
    )
    return [_record(*row, names) for row in rows]


def _record(
    row: Judgement, rater: Rater, task: Task, trial: Trial, sound: Sound, names: Mapping[int, str]
) -> AnswerRecord:
    ratings = {name: getattr(row, name) for name in QUESTIONS}
    return AnswerRecord(
        rater=rater.number,
        is_excluded=rater.is_excluded,
        trial=trial.id,
        role=trial.role,
        sound=sound.name,
        category=sound.category,
        systems=tuple(names.get(clip, "") for clip in trial.clips),
        ratings={name: value for name, value in ratings.items() if value is not None},
        best=row.best,
        worst=row.worst,
        skipped=row.skipped,
        order=tuple(task.order),
        first=task.first,
        seconds=row.seconds,
        clip_seconds=sound.seconds,
        plays=tuple(row.plays),
        at=row.at,
    )


def counted(answers: list[AnswerRecord]) -> list[AnswerRecord]:
    """The judgements that count in results: without practice, checks and excluded raters."""
    return [answer for answer in answers if answer.role == "real" and not answer.is_excluded]
