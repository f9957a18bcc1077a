import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echoavatar.engine.audio_queue import AudioQueue, HeardUntil, Span
from echoavatar.errors import EchoAvatarError, QueueFullError
from echoavatar.timing import CHUNK_SAMPLES


def ramp(count: int, first: int = 0) -> np.ndarray:
    return np.arange(first, first + count, dtype=np.float32) / 100_000


def paced(seconds: float = 60.0) -> AudioQueue:
    return AudioQueue(rewind=15, seconds=seconds, is_paced=True)


def taken(queue: AudioQueue, chunks: int) -> np.ndarray:
    return np.concatenate([queue.take() for _ in range(chunks)])


def spans(queue: AudioQueue, chunk: int) -> tuple[Span, ...]:
    return queue._spans[chunk]


def test_speech_comes_out_as_it_went_in_and_silence_follows_it() -> None:
    queue = AudioQueue()
    queue.push(ramp(9_000), 24_000)
    assert queue.has_chunk
    sound = taken(queue, 3)
    np.testing.assert_array_equal(sound[:9_000], ramp(9_000))
    assert not sound[9_000:].any()


def test_going_back_gives_the_same_again_and_a_cut_drops_the_rest() -> None:
    queue = AudioQueue(rewind=15)
    queue.push(ramp(20_000), 24_000)
    first = taken(queue, 2)
    queue.go_back(0)
    np.testing.assert_array_equal(taken(queue, 2), first)
    queue.go_back(1)
    queue.cut(7_000)
    queue.push(np.full(8_000, 0.5, np.float32), 24_000)
    again = taken(queue, 1)
    np.testing.assert_array_equal(again[:600], first[6_400:7_000])
    assert (again[600:] == 0.5).all()
    assert queue.seconds == (8_000 - 5_800) / 24_000


def test_stalling_delivers_what_the_resampler_holds_and_the_length_stays_exact() -> None:
    """1,000 samples at 8 kHz are 3,000 at 24 kHz; the filter's delay must not come out behind the silence."""
    queue = AudioQueue()
    queue.push(np.ones(1_000, np.float32), 8_000)
    queue.stall()
    speech = queue.take()
    assert abs(speech[2_900] - 1) < 0.1
    assert not speech[3_000:].any()
    assert not queue.has_chunk


def test_too_much_and_too_late_are_refused() -> None:
    queue = AudioQueue()
    with pytest.raises(QueueFullError, match="600 s of audio are waiting; send it in parts"):
        queue.push(np.zeros(601 * 24_000, np.float32), 24_000)
    queue.finish()
    with pytest.raises(EchoAvatarError, match="finished"):
        queue.push(np.zeros(1, np.float32), 24_000)


@settings(max_examples=30)
@given(cuts=st.lists(st.integers(1, 9_000), min_size=1, max_size=8))
def test_any_cut_of_an_utterance_is_the_same_sound(cuts: list[int]) -> None:
    queue, start = paced(), 0
    for cut in cuts:
        queue.push(ramp(cut, start), 24_000, utterance=1)
        start += cut
    queue.end_utterance(1)
    chunks = -(-start // CHUNK_SAMPLES)
    for _ in range(chunks):
        queue.schedule()
    sound = taken(queue, chunks)
    np.testing.assert_array_equal(sound[:start], ramp(start))
    assert not sound[start:].any()
    assert sum(span.length for chunk in range(chunks) for span in spans(queue, chunk)) == start
    assert queue.is_drained(1)


def test_a_paced_queue_gives_silence_until_speech_is_scheduled() -> None:
    queue = paced()
    queue.push(ramp(10_000, 1), 24_000, utterance=1)
    assert not queue.has_chunk
    assert not queue.take().any()
    queue.schedule()
    assert queue.has_chunk
    np.testing.assert_array_equal(queue.take(), ramp(6_400, 1))


def test_an_utterance_that_begins_is_not_torn_by_silence() -> None:
    """Half a chunk of a live voice is there when silence is due: a whole chunk of silence goes before it."""
    queue = paced()
    queue.push(ramp(3_000, 1), 24_000, utterance=1)
    queue.schedule()
    assert spans(queue, 0) == ()
    queue.push(ramp(4_000, 3_001), 24_000, utterance=1)
    for _ in range(2):  # later on it is torn: what there is should be heard
        queue.schedule()
    assert spans(queue, 1) == (Span(1, 0, 0, 6_400),)
    assert spans(queue, 2) == (Span(1, 6_400, 0, 600),)


def test_other_rates_keep_their_length() -> None:
    queue = paced()
    queue.push(ramp(20_000), 48_000, utterance=1)
    queue.end_utterance(1)
    assert queue.waiting == 10_000


def test_two_utterances_can_share_a_chunk_and_the_ends_of_both_are_known() -> None:
    queue = paced()
    for utterance in (1, 2):
        queue.push(ramp(4_000), 24_000, utterance)
        queue.end_utterance(utterance)
    queue.schedule()
    assert spans(queue, 0) == (Span(1, 0, 0, 4_000), Span(2, 0, 4_000, 2_400))
    assert (queue.is_drained(1), queue.is_drained(2)) == (True, False)
    queue.schedule()
    assert (queue.utterance_at(0), queue.utterance_at(1), queue.utterance_at(2)) == (1, 2, 0)
    assert queue.take_finished(CHUNK_SAMPLES) == (1, 4_000)
    assert queue.take_finished(CHUNK_SAMPLES) is None
    assert queue.take_finished(2 * CHUNK_SAMPLES) == (2, 8_000)


def test_a_cut_tells_which_utterance_was_cut_and_goes_on_in_silence() -> None:
    queue = paced()
    for utterance in (1, 2):
        queue.push(ramp(8_000, 1), 24_000, utterance)
        queue.end_utterance(utterance)
    for _ in range(3):
        queue.schedule()
    assert queue.cut(9_000) == HeardUntil(2, 1_000)
    assert queue.cut(9_000) == HeardUntil(0, 0)  # twice is once
    assert queue.end == 2 * CHUNK_SAMPLES
    assert not taken(queue, 2)[9_000:].any()
    assert queue.take_finished(10**9) is None  # what was cut off never finishes


def test_a_cut_drops_what_waits_and_keeps_what_came_after_it() -> None:
    queue = paced()
    queue.push(ramp(500, 1), 24_000, utterance=3)
    assert queue.cut(0, 3) == HeardUntil(3, 0)
    assert queue.waiting == 0
    for utterance in (4, 5):
        queue.push(ramp(500, 1), 24_000, utterance)
    queue.cut(0, 4)
    assert queue.waiting == 500


@settings(max_examples=50)
@given(heard=st.integers(0, 5 * CHUNK_SAMPLES))
def test_heard_is_counted_to_the_sample(heard: int) -> None:
    """One utterance of 4 chunks that begins at clock 6,400."""
    queue = paced()
    queue.schedule()
    queue.push(ramp(4 * CHUNK_SAMPLES, 1), 24_000, utterance=7)
    queue.end_utterance(7)
    for _ in range(4):
        queue.schedule()
    expected = (7, max(0, heard - CHUNK_SAMPLES)) if heard < 5 * CHUNK_SAMPLES else (0, 0)
    assert queue.cut(heard) == expected


def test_the_number_of_waiting_utterances_is_bounded() -> None:
    queue = paced()
    for utterance in range(1, 257):
        queue.push(ramp(1), 24_000, utterance)
    with pytest.raises(QueueFullError, match="256 utterances are waiting"):
        queue.push(ramp(1), 24_000, 257)
    queue.push(ramp(1), 24_000, 256)  # the newest may go on
    queue.schedule()
    queue.push(ramp(1), 24_000, 257)


def test_a_flood_of_single_samples_costs_no_more_than_its_samples() -> None:
    """60,000 messages of one sample, and as many questions whether the utterance is over."""
    queue, began = paced(), time.process_time()
    for _ in range(60_000):
        queue.push(ramp(1), 24_000, utterance=1)
        assert not queue.is_drained(1)
    assert len(queue._pieces) == 10
    assert time.process_time() - began < 6
