import msgspec
from tests.agents.client.test_recording import READY

from echoavatar.agents.client.utterances import UtteranceQueue
from echoavatar.wire.messages import Audio, AudioFormat, End, Flush, Sound


def sound(at: int, seg: int, samples: int = 6_400) -> Sound:
    return Sound(at=at, epoch=0, seg=seg, pcm=bytes(2 * samples))


def test_no_more_is_sent_than_the_server_has_room_for() -> None:
    queue = UtteranceQueue(AudioFormat())
    queue.add(bytes(48_000 * 100), end=True)
    sent = sum(len(message.pcm) for message in queue.due() if isinstance(message, Audio))
    assert 30 <= sent / 48_000 <= 32
    assert list(queue.due()) == []
    for at in range(0, 24_000 * 90, 6_400):
        queue.hear(sound(at, 1))
    assert isinstance(list(queue.due())[-1], End)


def test_a_resumed_session_is_sent_the_rest() -> None:
    queue = UtteranceQueue(AudioFormat())
    queue.add(bytes(20_000), end=True)
    list(queue.due())
    queue.go_on(msgspec.structs.replace(READY, seg=1, received=4_000))
    first, end = queue.due()
    assert isinstance(first, Audio)
    assert (first.start, len(first.pcm)) == (4_000, 12_000)
    assert end == End(seg=1)


def test_a_new_session_is_sent_what_was_not_played() -> None:
    queue = UtteranceQueue(AudioFormat(rate=48_000))
    queue.add(bytes(2 * 24_000), end=True)  # half a second
    list(queue.due())
    queue.hear(sound(0, 0))
    queue.hear(sound(6_400, 1))
    queue.begin_anew(READY)
    first, end = queue.due()
    assert isinstance(first, Audio)
    assert (first.start, len(first.pcm)) == (0, 2 * (24_000 - 12_800))
    assert end == End(seg=1)


def test_flushed_sound_counts_as_not_received_and_interrupted_speech_is_dropped() -> None:
    queue = UtteranceQueue(AudioFormat())
    queue.add(bytes(20_000), end=False)
    list(queue.due())
    queue.hear(sound(0, 1))
    queue.flush(Flush(at=0, epoch=1, seg=0, heard=0))
    assert queue.received == 0
    queue.interrupt()
    queue.begin_anew(READY)
    assert list(queue.due()) == []
    assert queue.add(b"", end=True) == 2


def test_old_utterances_are_forgotten() -> None:
    queue = UtteranceQueue(AudioFormat())
    for _ in range(20):
        queue.add(bytes(2), end=True)
        list(queue.due())
    assert 1 < len(queue._utterances) < 10
