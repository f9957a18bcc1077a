"""Owners: made once, signed in by password, told apart by nobody who guesses."""

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_studio.accounts import first_owner, log_in, owner_of, set_owner
from echoavatar_studio.errors import StudioError
from echoavatar_studio.making import Maker
from echoavatar_studio.run import open_store
from echoavatar_studio.sessions import find_visitor


def test_the_first_owner_is_made_once_with_a_random_password(tmp_path):
    store = open_store(tmp_path, None)
    password = first_owner(store)
    assert password is not None
    assert first_owner(store) is None
    token, session = log_in(store, "owner", password)
    visitor = find_visitor(store, token)
    assert visitor is not None
    assert (owner_of(store, visitor).name, visitor.csrf) == ("owner", session.csrf)
    store.close()


def test_a_new_password_replaces_the_old_one(maker: Maker):
    set_owner(maker.store, "anna", "another password")
    with pytest.raises(StudioError, match="wrong name or password"):
        log_in(maker.store, "anna", "a long password")
    log_in(maker.store, "anna", "another password")


def test_wrong_names_and_wrong_passwords_are_told_alike(maker: Maker):
    said = []
    for name in ("anna", "nobody"):
        with pytest.raises(StudioError) as told:
            log_in(maker.store, name, "guess")
        said.append((told.value.code, str(told.value)))
    assert said[0] == said[1]


def test_short_passwords_are_refused(maker: Maker):
    with pytest.raises(EchoAvatarError, match="at least 10 characters"):
        set_owner(maker.store, "bert", "short")
