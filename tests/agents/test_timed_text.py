"""Text in pieces becomes words with times."""

from math import inf, nan

import pytest

from echoavatar.agents.timed_text import TimedText


def words(*pieces: tuple[str, float] | tuple[str, float, float]) -> list[tuple[str, float] | tuple[str, float, float]]:
    text = TimedText()
    for piece in pieces:
        text.add(*piece)
    text.close()
    return [tuple(round(part, 6) if isinstance(part, float) else part for part in word) for word in text.take()]  # type: ignore[misc]


def test_letters_become_words_at_white_space() -> None:
    letters = [(letter, 0.1 * k, 0.1 * k + 0.1) for k, letter in enumerate("Over there,\n\tfriend")]
    assert words(*letters) == [("Over", 0.0, 0.4), ("there,", 0.5, 1.1), ("friend", 1.3, 1.9)]


def test_a_word_may_come_in_two_pieces_and_is_told_once_when_it_is_complete() -> None:
    text = TimedText()
    text.add("over th", 0.0)
    assert text.take() == [("over", 0.0)]
    text.add("ere ", 0.4, 0.5)
    assert text.take() == []  # a piece without an end does not say when its second word begins
    text.add("my", 0.6)
    text.add("self", 0.7, 0.9)
    assert text.take() == []
    text.add(" and", 1.0)
    assert text.take() == [("myself", 0.6, 0.9)]


def test_words_of_a_piece_share_its_time_by_their_letters() -> None:
    assert words(("we all are ", 1.0, 3.0)) == [("we", 1.0, 1.5), ("all", 1.5, 2.25), ("are", 2.25, 3.0)]
    assert words((" A sentence without its end. ", 1.0), ("Another.", 4.0)) == [("A", 1.0), ("Another.", 4.0)]


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        ([("no", nan), (" ", nan), ("yes", 1.0)], [("yes", 1.0)]),
        ([("first ", 1.0), ("overlaps ", 0.95), ("other-origin ", 0.2), ("last ", 2.0)], ["first", "overlaps", "last"]),
        ([("me ", -0.01), ("there ", 0.2, 0.1)], [("me", 0.0), ("there", 0.2)]),
        ([("far ", 1e6), ("gone ", inf), ("me ", 1.0, inf)], [("me", 1.0)]),
        ([("x" * 60, 0.0), ("x" * 60 + " ", 0.1), ("me", 1.0)], [("me", 1.0)]),
        ([("", 0.0), (" ", 0.0)], []),
    ],
)
def test_a_word_without_a_time_or_with_a_wrong_one_is_left_out(pieces: list, expected: list) -> None:  # type: ignore[type-arg]
    found = words(*pieces)
    assert ([word[0] for word in found] if "first" in expected else found) == expected
    assert [word[1] for word in found] == sorted(word[1] for word in found)


def test_there_is_never_more_than_a_message_holds() -> None:
    text = TimedText()
    text.add("me " * 5_000, 0.0, 100.0)
    assert len(text.take()) == 2_000
    text.add("me ", 101.0)
    assert text.take() == [("me", 101.0)]
