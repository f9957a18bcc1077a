"""How people become raters (invitation, consent, a block of tasks), and how they withdraw and are deleted."""

import time

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from .audit import note
from .errors import StudioError
from .secrecy import hash_token, new_token
from .sessions import Visitor, sign_in
from .settings import kept_study
from .store import Store
from .tables import Block, Invitation, Judgement, Rater, Study, Task
from .wire_rater import Joined, Progress, StudyFace


def join(store: Store, token: str, current: Visitor | None, *, page: str) -> tuple[str, Joined]:
    """Accept an invitation, or resume with a rater's own key; return the token for the cookie and the reply.

    `page` is the address that links begin with. A visitor who has joined by the same open invitation stays the same
    rater.

    Raises:
        StudioError: no such link, the study is closed, or all places are taken.
    """
    hashed = hash_token(token)
    with store.write() as session:
        rater = session.scalar(select(Rater).where(Rater.token_hash == hashed))
        resume, action = "", "came"
        if rater is None:
            invitation = session.scalar(select(Invitation).where(Invitation.token_hash == hashed).with_for_update())
            if invitation is None or invitation.is_revoked:
                raise StudioError("bad_invitation", "this link is not valid any more; ask who invited you")
            rater = _known(session, invitation, current)
            if rater is None:
                (rater, resume), action = _new(session, invitation, page), "joined"
        study = session.get_one(Study, rater.study_id)
        rater.seen = time.time()
        cookie, visitor = sign_in(session, rater_id=rater.id)
        note(session, f"rater {rater.number}", action, study=study.public)
        return cookie, _joined(session, study, rater, visitor, resume)


def rejoined(store: Store, visitor: Visitor) -> Joined:
    """The reply of `join` again, for a page that was reloaded."""
    with store.read() as session:
        rater = session.get_one(Rater, visitor.rater_id)
        return _joined(session, session.get_one(Study, rater.study_id), rater, visitor, "")


def agree(store: Store, visitor: Visitor) -> Joined:
    """Record the consent and assign the first free block.

    Raises:
        StudioError: the study is closed, or all blocks are taken.
    """
    with store.write() as session:
        rater = session.get_one(Rater, visitor.rater_id, with_for_update=True)
        study = session.get_one(Study, rater.study_id, with_for_update=True)
        if rater.consented is None:
            check_open(study)
            block = session.scalar(
                select(Block)
                .where(Block.study_id == study.id, Block.rater_id.is_(None))
                .order_by(Block.number)
                .limit(1)
            )
            if block is None:
                raise StudioError("study_full", "all places in this study are taken; thank you")
            block.rater_id = rater.id
            rater.consented = time.time()
            note(session, f"rater {rater.number}", "consented", study=study.public)
            session.flush()
        return _joined(session, study, rater, visitor, "")


def delete_rater(session: Session, rater: Rater, *, actor: str, why: str) -> None:
    """Delete a rater with all answers; the block is free again, and a personal link becomes invalid.

    The block of an excluded rater is deleted, too: a copy of it was handed out when the rater was excluded.
    """
    study = session.get_one(Study, rater.study_id)
    invitation = session.get_one(Invitation, rater.invitation_id)
    if invitation.is_open:
        invitation.taken -= 1
    else:
        invitation.is_revoked = True
    own = Block.rater_id == rater.id
    session.execute(delete(Block).where(own) if rater.is_excluded else update(Block).where(own).values(rater_id=None))
    note(session, actor, "rater deleted", study=study.public, detail=f"rater {rater.number}: {why}")
    session.delete(rater)


def check_open(study: Study) -> None:
    """Raise a StudioError unless the study takes answers."""
    if study.state != "open":
        raise StudioError("study_closed", "this study is closed; thank you")


def progress_of(session: Session, rater: Rater) -> Progress:
    """The progress of a rater."""
    of = session.scalar(
        select(func.count(Task.id)).join(Block, Task.block_id == Block.id).where(Block.rater_id == rater.id)
    )
    done = session.scalar(select(func.count(Judgement.id)).where(Judgement.rater_id == rater.id))
    return Progress(done=done or 0, of=of or 0, is_finished=bool(of) and done == of)


def _known(session: Session, invitation: Invitation, current: Visitor | None) -> Rater | None:
    wanted = select(Rater).where(Rater.invitation_id == invitation.id)
    if not invitation.is_open:
        return session.scalar(wanted)
    if current is None or current.rater_id is None:
        return None
    return session.scalar(wanted.where(Rater.id == current.rater_id))


def _new(session: Session, invitation: Invitation, page: str) -> tuple[Rater, str]:
    study = session.get_one(Study, invitation.study_id, with_for_update=True)
    check_open(study)
    if invitation.taken >= invitation.seats:
        raise StudioError("study_full", "everybody this link was meant for has come; ask for another")
    key = new_token() if invitation.is_open else ""
    number = session.scalar(select(func.max(Rater.number)).where(Rater.study_id == study.id)) or 0
    now = time.time()
    rater = Rater(
        study_id=study.id,
        invitation_id=invitation.id,
        number=number + 1,
        token_hash=hash_token(key) if key else None,
        joined=now,
        seen=now,
        consented=None,
    )
    invitation.taken += 1
    session.add(rater)
    session.flush()
    return rater, f"{page}#{key}" if key else ""


def _joined(session: Session, study: Study, rater: Rater, visitor: Visitor, resume: str) -> Joined:
    settings = kept_study(study.settings)
    face = StudyFace(
        title=study.title,
        kind=settings.kind,
        language=settings.language,
        intro=settings.intro,
        consent=settings.consent,
        presentation=settings.presentation if settings.kind == "pairwise" else "side_by_side",
        questions=settings.questions if settings.kind == "pairwise" else (),
        min_plays=settings.min_plays,
    )
    return Joined(
        csrf=visitor.csrf,
        study=face,
        has_consented=rater.consented is not None,
        progress=progress_of(session, rater),
        resume=resume,
    )
