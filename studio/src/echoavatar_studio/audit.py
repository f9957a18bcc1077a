"""The audit: one line for everything that changes something or was refused, written in the same transaction."""

import time
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from .store import Store
from .tables import Event
from .wire_owner import Audit
from .wire_owner import Event as EventRow

PAGE = 200
_LONGEST = 500


def note(session: Session, actor: str, action: str, *, study: str = "", detail: str = "") -> None:
    """Add a line; `actor` is `owner NAME`, `rater NUMBER`, `studio` or `stranger`."""
    told = detail[:_LONGEST].replace("\0", "\N{REPLACEMENT CHARACTER}")  # PostgreSQL stores no NUL
    session.add(Event(at=time.time(), actor=actor, action=action, study=study, detail=told))


def read_audit(store: Store, *, study: str = "", before: int | None = None) -> Audit:
    """The newest lines of one study or of all, older than line `before`."""
    wanted = select(Event).order_by(Event.id.desc()).limit(PAGE)
    if study:
        wanted = wanted.where(Event.study == study)
    if before is not None:
        wanted = wanted.where(Event.id < before)
    with store.read() as session:
        return Audit(events=tuple(map(_row, session.scalars(wanted))))


def _row(event: Event) -> EventRow:
    return EventRow(
        id=event.id, at=iso(event.at), actor=event.actor, action=event.action, study=event.study, detail=event.detail
    )


def iso(seconds: float) -> str:
    """A moment as ISO 8601 in UTC."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
