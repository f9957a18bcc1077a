"""The audit: newest first, by study, in pages, and in the transaction of what it tells."""

from collections.abc import Callable

import pytest
from studio.tests import canned
from studio.tests.people import OwnerPerson, RaterPerson, app_of

from echoavatar_studio.audit import PAGE, iso, note, read_audit
from echoavatar_studio.backup import back_up
from echoavatar_studio.making import Maker


def test_lines_come_newest_first_in_pages(maker: Maker):
    with maker.store.write() as session:
        for number in range(PAGE + 5):
            note(session, "test", "counted", study="one" if number % 2 else "two", detail=str(number))
    first = read_audit(maker.store).events
    assert [event.detail for event in first[:2]] == [str(PAGE + 4), str(PAGE + 3)]
    rest = read_audit(maker.store, before=first[-1].id).events
    assert len(first) == PAGE
    assert len(rest) == 5
    assert {event.study for event in read_audit(maker.store, study="one").events} == {"one"}


def test_what_was_undone_is_not_told(maker: Maker):
    def undone() -> None:
        with maker.store.write() as session:
            note(session, "test", "undone")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        undone()
    assert read_audit(maker.store).events == ()


def test_every_change_and_every_way_in_and_out_leaves_its_line(maker: Maker, library, tmp_path):
    """From set-up to deletion, over HTTP: each request that changes something adds exactly the line it should."""
    study, app = canned.make_pairwise(maker, library), app_of(maker)
    owner, rater, path = OwnerPerson(app), RaterPerson(app), f"/api/owner/studies/{study}"
    links: list[str] = []

    def invite() -> None:
        links.extend(
            link["url"].split("#")[1] for link in owner.post(f"{path}/invitations", {"count": 2}).json()["links"]
        )

    steps: list[tuple[Callable[[], object], str]] = [
        (owner.log_in, "owner anna: signed in"),
        (invite, "owner anna: invited"),
        (lambda: rater.join(links[0]), "rater 1: joined"),
        (lambda: rater.post("/api/rater/consent", {"agreed": True}), "rater 1: consented"),
        (lambda: rater.answer(rater.task()), "rater 1: judged"),
        (lambda: rater.post("/api/rater/leave"), "rater 1: signed out"),
        (lambda: rater.join(links[0]), "rater 1: came"),
        (lambda: owner.get(f"{path}/export/results.json"), "owner anna: exported"),
        (lambda: owner.post(f"{path}/raters/1/exclude", {"is_excluded": True}), "owner anna: rater excluded"),
        (lambda: owner.post(f"{path}/raters/1/exclude", {"is_excluded": False}), "owner anna: rater taken in again"),
        (lambda: owner.delete(f"{path}/invitations/2"), "owner anna: invitation revoked"),
        (lambda: rater.post("/api/rater/withdraw", {"sure": True}), "rater 1: rater deleted"),
        (lambda: owner.post(f"{path}/state", {"state": "closed"}), "owner anna: study closed"),
        (lambda: back_up(maker.store, maker.media, tmp_path / "b.zip"), "studio: backed up"),
        (lambda: owner.delete(path), "owner anna: study deleted"),
        (lambda: owner.post("/api/owner/logout"), "owner anna: signed out"),
    ]
    newest = read_audit(maker.store).events[0].id
    for step, line in steps:
        step()
        added = [event for event in read_audit(maker.store).events if event.id > newest]
        assert [f"{event.actor}: {event.action}" for event in added] == [line]
        newest = added[0].id


def test_moments_are_utc_and_details_are_cut():
    assert iso(0.0) == "1970-01-01T00:00:00Z"


def test_long_details_are_cut(maker: Maker):
    with maker.store.write() as session:
        note(session, "test", "told", detail="x" * 10_000)
    assert len(read_audit(maker.store).events[0].detail) == 500
