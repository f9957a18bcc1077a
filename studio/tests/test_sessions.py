"""Sessions end: by signing out, by age, with the person."""

from studio.tests import canned

from echoavatar_studio import sessions
from echoavatar_studio.accounts import log_in
from echoavatar_studio.making import Maker
from echoavatar_studio.tables import Login, Owner


def test_only_hashes_of_tokens_are_kept(maker: Maker):
    token, _ = log_in(maker.store, "anna", canned.PASSWORD)
    with maker.store.read() as session:
        kept = session.query(Login).one()
        assert token not in (kept.token_hash, kept.csrf)
    assert sessions.find_visitor(maker.store, token) is not None
    assert sessions.find_visitor(maker.store, token + "x") is None
    assert sessions.find_visitor(maker.store, "") is None


def test_signing_out_and_age_end_a_session(maker: Maker):
    token, _ = log_in(maker.store, "anna", canned.PASSWORD)
    visitor = sessions.find_visitor(maker.store, token)
    assert visitor is not None
    sessions.sign_out(maker.store, visitor)
    assert sessions.find_visitor(maker.store, token) is None
    old, _ = log_in(maker.store, "anna", canned.PASSWORD)
    with maker.store.write() as session:
        session.query(Login).update({"expires": 1.0})
    assert sessions.find_visitor(maker.store, old) is None
    log_in(maker.store, "anna", canned.PASSWORD)  # sweeps out what is too old
    with maker.store.read() as session:
        assert session.query(Login).count() == 1


def test_a_session_is_of_a_rater_or_of_an_owner(maker: Maker):
    visitor = sessions.find_visitor(maker.store, log_in(maker.store, "anna", canned.PASSWORD)[0])
    assert visitor is not None
    assert visitor.is_a("owner")
    assert not visitor.is_a("rater")


def test_sessions_end_with_the_person(maker: Maker):
    token, _ = log_in(maker.store, "anna", canned.PASSWORD)
    with maker.store.write() as session:
        session.delete(session.query(Owner).one())
    assert sessions.find_visitor(maker.store, token) is None
