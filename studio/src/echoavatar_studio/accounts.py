"""Accounts of owners, which are made on the command line, and signing in."""

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
def _stand_in_hash() -> str:
    """A hash to compare with when the owner does not exist, so that both cases take equally long."""
    return hash_password(secrets.token_urlsafe(16))


def set_owner(store: Store, name: str, password: str) -> None:
    """Create an owner, or set the password of one.

    Raises:
        EchoAvatarError: the password is too short.
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
    """Create the owner `owner` if there is no owner; return the random password, which is shown only once."""
    with store.read() as session:
        if session.scalar(select(func.count(Owner.id))):
            return None
    password = secrets.token_urlsafe(12)
    set_owner(store, "owner", password)
    return password


def log_in(store: Store, name: str, password: str) -> tuple[str, OwnerSession]:
    """Sign an owner in; return the token for the cookie and the reply to the page.

    Raises:
        StudioError: wrong name or password; the message does not say which.
    """
    with store.read() as session:
        owner = session.scalar(select(Owner).where(Owner.name == name))
    if not is_password(password, owner.password if owner else _stand_in_hash()) or owner is None:
        raise StudioError("bad_login", "wrong name or password")
    with store.write() as session:
        token, visitor = sign_in(session, owner_id=owner.id)
        note(session, f"owner {owner.name}", "signed in")
    return token, OwnerSession(name=owner.name, csrf=visitor.csrf)


def owner_of(store: Store, visitor: Visitor) -> Owner:
    """The owner who is signed in."""
    with store.read() as session:
        return session.get_one(Owner, visitor.owner_id)
