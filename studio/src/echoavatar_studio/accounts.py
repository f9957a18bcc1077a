"""Owners: accounts, made on the command line, and signing in."""

import secrets
import time
from functools import lru_cache

from sqlalchemy import func, select

from echoavatar.errors import EchoAvatarError

from .audit import note
from .errors import StudioError
from .secrecy import MIN_PASSWORD, hash_password, is_password
from .sessions import Visitor, sign_in
from .store import Store
from .tables import Owner
from .wire_owner import OwnerSession


@lru_cache(maxsize=1)
def _nobody() -> str:
    """Compared with where there is no such owner, so that both take equally long."""
    return hash_password(secrets.token_urlsafe(16))


def set_owner(store: Store, name: str, password: str) -> None:
    """A new owner, or a new password for one.

    Raises:
        EchoAvatarError: the password is too short to be one.
    """
    if len(password) < MIN_PASSWORD:
        raise EchoAvatarError(f"a password has at least {MIN_PASSWORD} characters; choose a longer one")
    kept = hash_password(password)
    with store.write() as session:
        owner = session.scalar(select(Owner).where(Owner.name == name))
        if owner is None:
            session.add(Owner(name=name, password=kept, created=time.time()))
        else:
            owner.password = kept
        note(session, "studio", "owner set", detail=name)


def first_owner(store: Store) -> str | None:
    """Make the owner `owner` with a random password where there is none; gives the password, which is told once."""
    with store.read() as session:
        if session.scalar(select(func.count(Owner.id))):
            return None
    password = secrets.token_urlsafe(12)
    set_owner(store, "owner", password)
    return password


def log_in(store: Store, name: str, password: str) -> tuple[str, OwnerSession]:
    """The cookie's token, and what the page is told.

    Raises:
        StudioError: wrong name or password; which of them is not told.
    """
    with store.read() as session:
        owner = session.scalar(select(Owner).where(Owner.name == name))
    if not is_password(password, owner.password if owner else _nobody()) or owner is None:
        raise StudioError("bad_login", "wrong name or password")
    with store.write() as session:
        token, visitor = sign_in(session, owner_id=owner.id)
        note(session, f"owner {owner.name}", "signed in")
    return token, OwnerSession(name=owner.name, csrf=visitor.csrf)


def owner_of(store: Store, visitor: Visitor) -> Owner:
    """Who is signed in."""
    with store.read() as session:
        return session.get_one(Owner, visitor.owner_id)
