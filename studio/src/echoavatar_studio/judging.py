"""A rater's tasks and answers. An answer is reported as saved only when it is on disk, and it is stored once."""

import hashlib
import time
from pathlib import Path

import msgspec
from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from .audit import note
from .errors import StudioError, not_found
from .joining import check_open, progress_of
from .sessions import Visitor
from .settings import kept_study
from .store import Store
from .tables import Block, Clip, Judgement, Rater, Sound, Study, Task, Trial
from .wire_rater import Answer, NextTask, PairwiseAnswer, PreferenceAnswer, RaterTask, Saved, SkipAnswer

TASKS = "/api/rater/tasks"


def next_task(store: Store, visitor: Visitor) -> NextTask:
    """The first task without an answer, and the one after it.

    Raises:
        StudioError: no consent yet, or the study is closed.
    """
    with store.read() as session:
        rater = _consenting(session, visitor)
        check_open(session.get_one(Study, rater.study_id))
        answered = select(Judgement.task_id).where(Judgement.rater_id == rater.id)
        rows = session.execute(_tasks(rater).where(Task.id.not_in(answered)).limit(2)).all()
        tasks = [_shown(*row) for row in rows]
        return NextTask(
            task=tasks[0] if tasks else None,
            ahead=tasks[1] if len(tasks) > 1 else None,
            progress=progress_of(session, rater),
        )


def media_of(store: Store, visitor: Visitor, name: str, slot: int | None) -> str:
    """The file, below the media folder, of a task's sound or of the clip in a slot.

    Raises:
        StudioError: the task is not of this rater, or there is no such slot.
    """
    with store.read() as session:
        rater = _consenting(session, visitor)
        found = session.execute(_tasks(rater).where(Task.public == name)).first()
        if found is None:
            raise not_found()
        task, trial, sound = found
        if slot is None:
            return sound.path
        if slot >= len(task.order):
            raise not_found()
        return session.get_one(Clip, trial.clips[task.order[slot]]).path


def judge(store: Store, visitor: Visitor, name: str, key: str, answer: Answer) -> Saved:
    """Store an answer; return when it is on disk.

    Raises:
        StudioError: the task is of another rater or already answered, the key belongs to another answer, or the answer
            does not fit the task.
    """
    digest = hashlib.sha256(name.encode() + b"\0" + msgspec.json.encode(answer, order="sorted")).hexdigest()
    with store.write() as session:
        rater = session.get_one(Rater, visitor.rater_id, with_for_update=True)  # one answer of a rater at a time
        before = session.scalar(select(Judgement).where(Judgement.rater_id == rater.id, Judgement.key == key))
        if before is not None:
            if before.digest != digest:
                raise StudioError("key_reused", "this idempotency key belongs to another answer; make a new one")
            return Saved(is_repeated=True, progress=progress_of(session, rater))
        _consenting(session, visitor)
        study = session.get_one(Study, rater.study_id)
        check_open(study)
        found = session.execute(_tasks(rater).where(Task.public == name)).first()
        if found is None:
            raise not_found()
        task, trial, _ = found
        if session.scalar(select(Judgement.id).where(Judgement.task_id == task.id)) is not None:
            raise StudioError("already_judged", "this task has an answer already; go on with the next")
        row = _row(answer, task, study)
        row.task_id, row.rater_id, row.key, row.digest = task.id, rater.id, key, digest
        session.add(row)
        rater.seen = row.at
        note(session, f"rater {rater.number}", "judged", study=study.public, detail=f"task {task.position + 1}")
        session.flush()
        saved = Saved(is_repeated=False, progress=progress_of(session, rater))
    return saved  # the transaction has ended: the answer is on disk


def _row(answer: Answer, task: Task, study: Study) -> Judgement:
    settings, clips = kept_study(study.settings), len(task.order)
    if len(answer.plays) != clips:
        raise StudioError("bad_request", f"plays has {len(answer.plays)} numbers, the task {clips} clips")
    is_broken = isinstance(answer, SkipAnswer) and answer.reason == "cannot_play"
    if not is_broken and min(answer.plays) < settings.min_plays:
        raise StudioError("bad_request", f"every clip must be played {settings.min_plays} times before an answer")
    row = Judgement(seconds=answer.seconds, plays=_by_place(answer.plays, task), at=time.time())
    match answer:
        case PairwiseAnswer() if settings.kind == "pairwise":
            if set(answer.ratings) != set(settings.questions):
                raise StudioError("bad_request", f"ratings must answer {', '.join(settings.questions)}, each once")
            towards_first = 1 if task.order[0] == 1 else -1  # a rating is towards slot 1
            for question, rating in answer.ratings.items():
                setattr(row, question, towards_first * rating)
        case PreferenceAnswer() if settings.kind == "preference":
            if max(answer.best, answer.worst) >= clips or answer.best == answer.worst:
                raise StudioError("bad_request", f"best and worst must be two different ones of {clips} clips")
            row.best, row.worst = task.order[answer.best], task.order[answer.worst]
        case SkipAnswer() if settings.kind == "preference" or answer.reason == "cannot_play":
            row.skipped = answer.reason
        case _:
            raise StudioError("bad_request", f"this is no answer to a task of a {settings.kind} study")
    return row


def _by_place(plays: tuple[int, ...], task: Task) -> list[int]:
    counts = [0] * len(plays)
    for slot, count in enumerate(plays):
        counts[task.order[slot]] = count
    return counts


def _consenting(session: Session, visitor: Visitor) -> Rater:
    rater = session.get_one(Rater, visitor.rater_id)
    if rater.consented is None:
        raise StudioError("needs_consent", "please read the consent first")
    return rater


def _tasks(rater: Rater) -> Select[Task, Trial, Sound]:
    return (
        select(Task, Trial, Sound)
        .join(Block, Task.block_id == Block.id)
        .join(Trial, Task.trial_id == Trial.id)
        .join(Sound, Trial.sound_id == Sound.id)
        .where(Block.rater_id == rater.id)
        .order_by(Task.position)
    )


def _shown(task: Task, trial: Trial, sound: Sound) -> RaterTask:
    address = f"{TASKS}/{task.public}"
    return RaterTask(
        id=task.public,
        stage="training" if trial.role == "training" else "rating",
        number=task.position + 1,
        seconds=sound.seconds,
        audio=f"{address}/audio",
        clips=tuple(f"{address}/clips/{slot}" for slot in range(len(task.order))),
        first=task.first,
    )


def media_path(folder: Path, name: str) -> Path:
    """A file of the media folder; names come from our own tables, never from a request."""
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise not_found()
    return path
