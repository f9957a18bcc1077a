"""Utterances in, chunks out, and who spoke where."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echoavatar.server.intake import Intake, Ledger, Span
from echoavatar.timing import CHUNK_SAMPLES
from echoavatar.wire import Audio, AudioFormat, ProtocolError


def ramp(count: int, first: int = 0) -> bytes:
    return (np.arange(first, first + count) % 30_000).astype("<i2").tobytes()


def intake(seconds: float = 60.0, rate: int = 24_000) -> Intake:
    return Intake(AudioFormat(rate=rate), seconds=seconds)


@settings(max_examples=30)
@given(cuts=st.lists(st.integers(1, 9_000), min_size=1, max_size=8))
def test_any_cut_of_an_utterance_is_the_same_sound(cuts: list[int]) -> None:
    took, start = intake(), 0
    for cut in cuts:
        took.push(Audio(seg=1, start=start, pcm=ramp(cut, start)))
        start += cut
    took.end(1)
    chunks, spans = zip(*[took.next_chunk() for _ in range(-(-start // CHUNK_SAMPLES))], strict=True)
    sound = np.concatenate(chunks) * 32_768
    np.testing.assert_array_equal(sound[:start], np.arange(start) % 30_000)
    assert not sound[start:].any()
    assert sum(span.length for chunk in spans for span in chunk) == start
    assert took.is_drained(1)


def test_what_was_sent_twice_is_heard_once() -> None:
    took = intake()
    took.push(Audio(seg=1, start=0, pcm=ramp(100)))
    assert len(took.push(Audio(seg=1, start=40, pcm=ramp(100, 40)))) == 40
    assert took.received == 140
    assert took.waiting == 140


def test_a_gap_is_refused_and_can_be_filled() -> None:
    took = intake()
    with pytest.raises(ProtocolError, match="expected 0") as caught:
        took.push(Audio(seg=1, start=5, pcm=ramp(10)))
    assert caught.value.code == "bad_order"
    assert not caught.value.fatal
    took.push(Audio(seg=1, start=0, pcm=ramp(10)))
    assert took.received == 10


def test_sound_after_the_end_is_refused() -> None:
    took = intake()
    took.push(Audio(seg=1, start=0, pcm=ramp(10)))
    took.end(1)
    with pytest.raises(ProtocolError, match="has ended"):
        took.push(Audio(seg=1, start=10, pcm=ramp(10)))


def test_a_full_inbox_refuses_and_keeps_what_it_has() -> None:
    took = intake(seconds=1.0)
    took.push(Audio(seg=1, start=0, pcm=ramp(24_000)))
    with pytest.raises(ProtocolError, match="1 s are waiting") as caught:
        took.push(Audio(seg=1, start=24_000, pcm=ramp(10)))
    assert caught.value.code == "inbox_full"
    assert (took.received, took.waiting) == (24_000, 24_000)


def test_cut_utterances_are_ignored_from_then_on() -> None:
    took = intake()
    took.push(Audio(seg=3, start=0, pcm=ramp(500)))
    assert took.cut(3) == (3, 0)
    took.push(Audio(seg=3, start=500, pcm=ramp(500)))
    took.push(Audio(seg=2, start=0, pcm=ramp(500)))
    assert took.waiting == 0
    assert not took.is_drained(3)
    took.push(Audio(seg=4, start=0, pcm=ramp(500)))
    assert took.waiting == 500


def test_an_utterance_that_begins_is_not_torn_by_silence() -> None:
    """Half a chunk of a live voice is there when silence is due: a whole chunk of silence goes before it."""
    took = intake()
    took.push(Audio(seg=1, start=0, pcm=ramp(3_000)))
    chunk, spans = took.next_chunk()
    assert not chunk.any()
    assert spans == ()
    took.push(Audio(seg=1, start=3_000, pcm=ramp(4_000, 3_000)))
    assert took.next_chunk()[1] == (Span(1, 0, 0, 6_400),)
    assert took.next_chunk()[1] == (Span(1, 6_400, 0, 600),)  # later on it is: what there is should be heard


def test_other_rates_keep_their_length() -> None:
    took = intake(rate=48_000)
    took.push(Audio(seg=1, start=0, pcm=ramp(20_000)))
    took.end(1)
    assert took.waiting == 10_000


def test_two_utterances_can_share_a_chunk() -> None:
    took = intake()
    for seg in (1, 2):
        took.push(Audio(seg=seg, start=0, pcm=ramp(4_000)))
        took.end(seg)
    assert took.next_chunk()[1] == (Span(1, 0, 0, 4_000), Span(2, 0, 4_000, 2_400))
    assert took.is_drained(1)
    assert not took.is_drained(2)


def test_the_ledger_knows_what_was_heard() -> None:
    ledger = Ledger()
    ledger.write(2, (Span(1, 0, 0, 4_000), Span(2, 0, 4_000, 2_400)))
    ledger.write(3, (Span(2, 2_400, 0, 6_400),))
    assert (ledger.speaks(2), ledger.speaks(3), ledger.speaks(4)) == (1, 2, 0)
    assert ledger.ends(3 * CHUNK_SAMPLES) == {1: 2 * CHUNK_SAMPLES + 4_000}
    assert ledger.cut(2 * CHUNK_SAMPLES + 5_000) == (2, 1_000)
    assert ledger.cut(2 * CHUNK_SAMPLES + 5_000) == (0, 0)  # twice is once
    assert ledger.cut(2 * CHUNK_SAMPLES + 1_000) == (1, 1_000)


@settings(max_examples=50)
@given(heard=st.integers(0, 5 * CHUNK_SAMPLES))
def test_heard_is_counted_to_the_sample(heard: int) -> None:
    """One utterance of 4 chunks that begins at clock 6,400."""
    ledger = Ledger()
    for chunk in range(1, 5):
        ledger.write(chunk, (Span(7, (chunk - 1) * CHUNK_SAMPLES, 0, CHUNK_SAMPLES),))
    expected = (7, max(0, heard - CHUNK_SAMPLES)) if heard < 5 * CHUNK_SAMPLES else (0, 0)
    assert ledger.cut(heard) == expected
