"""The actions of owners on studies: list, show, open, close, invite, exclude and delete."""

import shutil
import time
from collections.abc import Sequence

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from .audit import iso, note
from .errors import StudioError, not_found
from .joining import delete_rater
from .making import Maker
from .secrecy import hash_token, is_name, new_name, new_token
from .tables import Block, Clip, Invitation, Judgement, Rater, Sound, Study, System, Task, Trial
from .wire import CATEGORIES
from .wire_owner import (
    CellRow,
    InvitationRow,
    Invitations,
    Invite,
    Invited,
    Link,
    StudyDetail,
    StudyList,
    StudyRow,
    SystemRow,
)

_HOUR = 3_600.0


class OwnerActions:
    """The actions of one owner on the store; `actor` is the owner's name in the audit."""

    def __init__(self, maker: Maker, actor: str) -> None:
        self._maker, self._store, self.actor = maker, maker.store, actor

    def studies(self) -> StudyList:
        """All studies, newest first."""
        with self._store.read() as session:
            found = session.scalars(select(Study).order_by(Study.created.desc(), Study.id.desc())).all()
            return StudyList(studies=tuple(self._row(session, study) for study in found))

    def study(self, public: str) -> StudyDetail:
        """One study in full."""
        with self._store.read() as session:
            study = find_study(session, public)
            return StudyDetail(
                study=self._row(session, study),
                settings=study.settings,
                systems=_systems(session, study),
                progress=_cells(session, study),
                per_hour=_per_hour(session, study),
            )

    def row(self, public: str) -> StudyRow:
        """One study as a row of the list."""
        with self._store.read() as session:
            return self._row(session, find_study(session, public))

    def change_state(self, public: str, state: str) -> StudyRow:
        """Open or close a study.

        Raises:
            StudioError: the study is not made yet, or its making failed.
        """
        with self._store.write() as session:
            study = find_study(session, public)
            if study.state not in ("open", "closed"):
                raise StudioError("busy", f"the study is {study.state}; it cannot be {state}")
            study.state = state
            note(session, self.actor, f"study {state}", study=public)
            session.flush()
            return self._row(session, study)

    def delete(self, public: str) -> None:
        """Delete a study with its clips, raters and answers.

        Raises:
            StudioError: the study is open or being made.
        """
        with self._store.write() as session:
            study = find_study(session, public)
            if study.state not in ("closed", "failed"):
                raise StudioError("busy", "close the study first")
            session.delete(study)
            note(session, self.actor, "study deleted", study=public, detail=study.title)
        if is_name(public):  # a name that we did not make could lead out of the media folder
            shutil.rmtree(self._maker.media / public, ignore_errors=True)

    def invite(self, public: str, asked: Invite, *, page: str) -> Invited:
        """Create links. They are shown only now; the store keeps only hashes."""
        links = []
        with self._store.write() as session:
            study = find_study(session, public)
            for _ in range(1 if asked.is_open else asked.count):
                token = new_token()
                row = Invitation(
                    study_id=study.id,
                    token_hash=hash_token(token),
                    label=asked.label,
                    is_open=asked.is_open,
                    seats=asked.count if asked.is_open else 1,
                    created=time.time(),
                )
                session.add(row)
                session.flush()
                links.append(Link(id=row.id, url=f"{page}#{token}"))
            what = f"open, {asked.count} seats" if asked.is_open else f"{asked.count} personal"
            note(session, self.actor, "invited", study=public, detail=what)
        return Invited(links=tuple(links))

    def invitations(self, public: str) -> Invitations:
        """All invitations of a study."""
        with self._store.read() as session:
            study = find_study(session, public)
            wanted = select(Invitation).where(Invitation.study_id == study.id).order_by(Invitation.id)
            return Invitations(invitations=tuple(_invitation(row) for row in session.scalars(wanted)))

    def revoke(self, public: str, number: int) -> None:
        """Revoke a link: nobody can join by it any more. Raters who have joined continue with their own key."""
        with self._store.write() as session:
            row = session.get(Invitation, number)
            if row is None or row.study_id != find_study(session, public).id:
                raise not_found()
            row.is_revoked = True
            note(session, self.actor, "invitation revoked", study=public, detail=str(number))

    def exclude(self, public: str, number: int, *, is_excluded: bool, reason: str) -> None:
        """Exclude a rater from the results, or include them again; the tasks of an excluded rater go to another one.

        A repeated call changes nothing. Including a rater again withdraws the copied tasks if nobody has begun them.
        """
        with self._store.write() as session:
            rater = _rater(session, public, number)
            if is_excluded != rater.is_excluded:
                (_give_out_again if is_excluded else _take_back)(session, rater)
            rater.is_excluded, rater.reason = is_excluded, reason if is_excluded else ""
            action = "rater excluded" if is_excluded else "rater taken in again"
            note(session, self.actor, action, study=public, detail=f"rater {number}: {reason}")

    def delete_rater(self, public: str, number: int) -> None:
        """Delete a rater with all their answers."""
        with self._store.write() as session:
            delete_rater(session, _rater(session, public, number), actor=self.actor, why="on request")

    def _row(self, session: Session, study: Study) -> StudyRow:
        wanted = session.scalar(
            select(func.count(Task.id))
            .join(Trial, Task.trial_id == Trial.id)
            .where(Trial.study_id == study.id, Trial.role == "real")
        )
        done = session.scalar(
            select(func.count(Judgement.id))
            .select_from(Judgement)
            .join(Task, Judgement.task_id == Task.id)
            .join(Trial, Task.trial_id == Trial.id)
            .where(Trial.study_id == study.id, Trial.role == "real")
        )
        raters = session.scalar(select(func.count(Rater.id)).where(Rater.study_id == study.id))
        places = session.scalar(select(func.count(Block.id)).where(Block.study_id == study.id))
        return StudyRow(
            id=study.public,
            title=study.title,
            kind=study.kind,  # type: ignore[arg-type]
            state=study.state,  # type: ignore[arg-type]
            created=iso(study.created),
            making=self._maker.making.get(study.public),
            problem=study.problem,
            raters=raters or 0,
            raters_wanted=places or 0,
            judgements=done or 0,
            judgements_wanted=wanted or 0,
        )


def find_study(session: Session, public: str) -> Study:
    """The study with a public name; raises a StudioError if there is none."""
    study = session.scalar(select(Study).where(Study.public == public))
    if study is None:
        raise not_found()
    return study


def _rater(session: Session, public: str, number: int) -> Rater:
    study = find_study(session, public)
    rater = session.scalar(select(Rater).where(Rater.study_id == study.id, Rater.number == number))
    if rater is None:
        raise not_found()
    return rater


def _give_out_again(session: Session, rater: Rater) -> None:
    """Make a copy of the rater's block for another rater, once."""
    block = session.scalar(select(Block).where(Block.rater_id == rater.id))
    if block is None:
        return
    last = session.scalar(select(func.max(Block.number)).where(Block.study_id == rater.study_id)) or 0
    copy = Block(study_id=rater.study_id, number=last + 1)
    session.add(copy)
    session.flush()
    for task in session.scalars(select(Task).where(Task.block_id == block.id)).all():
        kept = {name: getattr(task, name) for name in ("trial_id", "position", "order", "first")}
        session.add(Task(public=new_name(), block_id=copy.id, **kept))


def _take_back(session: Session, rater: Rater) -> None:
    """Delete the copy of the rater's block if no other rater has it yet."""
    block = session.scalar(select(Block).where(Block.rater_id == rater.id))
    free = select(Block).where(Block.study_id == rater.study_id, Block.rater_id.is_(None))
    for copy in session.scalars(free.order_by(Block.number.desc())).all():
        if block is not None and _trials(session, copy) == _trials(session, block):
            return session.delete(copy)


def _trials(session: Session, block: Block) -> list[tuple[int, int]]:
    wanted = select(Task.position, Task.trial_id).where(Task.block_id == block.id).order_by(Task.position)
    return [(position, trial) for position, trial in session.execute(wanted)]


def _invitation(row: Invitation) -> InvitationRow:
    return InvitationRow(
        id=row.id,
        label=row.label,
        is_open=row.is_open,
        seats=row.seats,
        taken=row.taken,
        is_revoked=row.is_revoked,
        created=iso(row.created),
    )


def _systems(session: Session, study: Study) -> tuple[SystemRow, ...]:
    rows = []
    times: dict[int, int] = dict(
        session.execute(
            select(Task.trial_id, func.count(Judgement.id))
            .join(Judgement, Judgement.task_id == Task.id)
            .group_by(Task.trial_id)
        ).all()
    )
    real = session.scalars(select(Trial).where(Trial.study_id == study.id, Trial.role == "real")).all()
    clips: dict[int | None, list[int]] = {}
    for clip, of in session.execute(select(Clip.id, Clip.system_id).where(Clip.study_id == study.id)):
        clips.setdefault(of, []).append(clip)
    for system in session.scalars(select(System).where(System.study_id == study.id).order_by(System.place)):
        own = set(clips.get(system.id, ()))
        count = sum(times.get(trial.id, 0) for trial in real if own.intersection(trial.clips))
        rows.append(SystemRow(name=system.name, source=system.source, clips=len(own), judgements=count))
    return tuple(rows)


def _cells(session: Session, study: Study) -> tuple[CellRow, ...]:
    rows = []
    for category in CATEGORIES:
        here = (Trial.study_id == study.id, Trial.role == "real", Sound.category == category)
        tasks = (
            select(func.count(Task.id)).join(Trial, Task.trial_id == Trial.id).join(Sound, Trial.sound_id == Sound.id)
        )
        of = session.scalar(tasks.where(*here)) or 0
        done = session.scalar(tasks.join(Judgement, Judgement.task_id == Task.id).where(*here)) or 0
        sounds = session.scalar(
            select(func.count(Sound.id)).where(Sound.study_id == study.id, Sound.category == category)
        )
        if sounds:
            rows.append(CellRow(category=category, sounds=sounds, done=done, of=of))
    return tuple(rows)


def _per_hour(session: Session, study: Study) -> tuple[int, ...]:
    now, hours = time.time(), 24
    moments: Sequence[float] = session.scalars(
        select(Judgement.at)
        .join(Rater, Judgement.rater_id == Rater.id)
        .where(Rater.study_id == study.id, Judgement.at > now - hours * _HOUR)
    ).all()
    counts = [0] * hours
    for at in moments:
        ago = min(max(0, int((now - at) // _HOUR)), hours - 1)  # the clock may have been set back since
        counts[hours - 1 - ago] += 1
    return tuple(counts)
