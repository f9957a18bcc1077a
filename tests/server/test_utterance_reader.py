"""The sound of one speaker comes once and in order, whatever is sent twice, too early or too late."""

import numpy as np
import pytest

from echoavatar.server.utterance_reader import UtteranceReader
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.messages import Audio, AudioFormat


def audio(seg: int, start: int, count: int) -> Audio:
    return Audio(seg=seg, start=start, pcm=(np.arange(start, start + count) % 30_000).astype("<i2").tobytes())


def took(reader: UtteranceReader, message: Audio) -> int | None:
    """How many samples of a message are new; they are accepted."""
    new = reader.read(message)
    if new is None:
        return None
    reader.accept(message.seg, len(new))
    return len(new)


@pytest.fixture
def reader() -> UtteranceReader:
    return UtteranceReader(AudioFormat(rate=24_000))


def test_what_was_sent_twice_is_taken_once(reader: UtteranceReader) -> None:
    assert took(reader, audio(1, 0, 100)) == 100
    assert took(reader, audio(1, 40, 100)) == 40
    assert (reader.seg, reader.received) == (1, 140)


def test_a_message_that_is_not_accepted_can_be_sent_again(reader: UtteranceReader) -> None:
    assert reader.read(audio(1, 0, 100)) is not None
    assert took(reader, audio(1, 0, 100)) == 100


def test_a_gap_is_refused_and_can_be_filled(reader: UtteranceReader) -> None:
    with pytest.raises(ProtocolError, match="expected 0") as caught:
        reader.read(audio(1, 5, 10))
    assert caught.value.code == "bad_order"
    assert not caught.value.fatal
    assert took(reader, audio(1, 0, 10)) == 10


def test_sound_after_the_end_is_refused(reader: UtteranceReader) -> None:
    took(reader, audio(1, 0, 10))
    assert reader.end(1)
    assert not reader.end(1)
    with pytest.raises(ProtocolError, match="has ended"):
        reader.read(audio(1, 10, 10))


def test_cut_utterances_are_ignored_from_then_on(reader: UtteranceReader) -> None:
    took(reader, audio(3, 0, 500))
    reader.cut(4)
    for message in (audio(3, 500, 500), audio(2, 0, 500), audio(4, 0, 500)):
        assert took(reader, message) is None
    assert not reader.end(4)
    assert took(reader, audio(5, 0, 500)) == 500
