"""The audit: newest first, by study, in pages, and in the transaction of what it tells."""

import pytest

from echoavatar.studio.audit import PAGE, iso, note, read_audit
from echoavatar.studio.making import Maker


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


def test_moments_are_utc_and_details_are_cut():
    assert iso(0.0) == "1970-01-01T00:00:00Z"


def test_long_details_are_cut(maker: Maker):
    with maker.store.write() as session:
        note(session, "test", "told", detail="x" * 10_000)
    assert len(read_audit(maker.store).events[0].detail) == 500
