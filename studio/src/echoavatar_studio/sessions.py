"""Sessions: a random token in a cookie, its hash in the store, and the CSRF token of the session's pages."""

import time
from dataclasses import dataclass
from typing import Literal

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from .audit import note
from .secrecy import hash_token, new_token
from .store import Store
from .tables import Login, Owner, Rater, Study

RATER_SECONDS = 60 * 86_400.0
OWNER_SECONDS = 12 * 3_600.0


@dataclass(frozen=True)
class Visitor:
    """A signed-in owner or rater."""

    login_id: int
    csrf: str
    owner_id: int | None
    rater_id: int | None

    def is_a(self, who: Literal["rater", "owner"]) -> bool:
        """Whether the session is of this kind: rater (opened by a link) or owner (by a password)."""
        return (self.rater_id if who == "rater" else self.owner_id) is not None


def sign_in(session: Session, *, owner_id: int | None = None, rater_id: int | None = None) -> tuple[str, Visitor]:
    """Open a session; return the token for the cookie, and the visitor."""
    token, csrf, now = new_token(), new_token(), time.time()
    session.execute(delete(Login).where(Login.expires < now))
    expires = now + (OWNER_SECONDS if owner_id is not None else RATER_SECONDS)
    row = Login(token_hash=hash_token(token), csrf=csrf, owner_id=owner_id, rater_id=rater_id, expires=expires)
    session.add(row)
    session.flush()
    return token, Visitor(row.id, csrf, owner_id, rater_id)


def find_visitor(store: Store, token: str) -> Visitor | None:
    """The visitor with this cookie, or None if the session is unknown or expired."""
    if not token:
        return None
    with store.read() as session:
        row = session.scalar(select(Login).where(Login.token_hash == hash_token(token), Login.expires > time.time()))
        return None if row is None else Visitor(row.id, row.csrf, row.owner_id, row.rater_id)


def sign_out(store: Store, visitor: Visitor) -> None:
    """End a session."""
    with store.write() as session:
        actor, study = name_of(session, visitor)
        note(session, actor, "signed out", study=study)
        session.execute(delete(Login).where(Login.id == visitor.login_id))


def name_of(session: Session, visitor: Visitor | None) -> tuple[str, str]:
    """The name of a visitor in the audit, and the study if the visitor is a rater."""
    if visitor and visitor.rater_id and (rater := session.get(Rater, visitor.rater_id)):
        return f"rater {rater.number}", session.get_one(Study, rater.study_id).public
    if visitor and visitor.owner_id and (owner := session.get(Owner, visitor.owner_id)):
        return f"owner {owner.name}", ""
    return "stranger", ""
