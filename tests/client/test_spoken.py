"""What was said, sent as there is room, and told again where it must."""

from tests.client.test_recording import READY

from echoavatar.client.spoken import AHEAD_S, KEPT, Spoken
from echoavatar.wire import Audio, AudioFormat, End, Flush, Sound


def sound(at: int, seg: int, samples: int = 6_400) -> Sound:
    return Sound(at=at, epoch=0, seg=seg, pcm=bytes(2 * samples))


def test_no_more_is_sent_than_there_is_room_for() -> None:
    spoken = Spoken(AudioFormat())
    spoken.add(bytes(48_000 * 100), end=True)
    sent = sum(len(message.pcm) for message in spoken.due() if isinstance(message, Audio))
    assert AHEAD_S <= sent / 48_000 <= AHEAD_S + 2
    assert list(spoken.due()) == []
    for at in range(0, 24_000 * 90, 6_400):
        spoken.hear(sound(at, 1))
    assert isinstance(list(spoken.due())[-1], End)


def test_a_resumed_session_is_told_the_rest() -> None:
    import msgspec

    spoken = Spoken(AudioFormat())
    spoken.add(bytes(20_000), end=True)
    list(spoken.due())
    spoken.go_on(msgspec.structs.replace(READY, seg=1, received=4_000))
    first, end = spoken.due()
    assert isinstance(first, Audio)
    assert (first.start, len(first.pcm)) == (4_000, 12_000)
    assert end == End(seg=1)


def test_a_new_session_is_told_what_did_not_come_back() -> None:
    spoken = Spoken(AudioFormat(rate=48_000))
    spoken.add(bytes(2 * 24_000), end=True)  # half a second
    list(spoken.due())
    spoken.hear(sound(0, 0))
    spoken.hear(sound(6_400, 1))
    spoken.begin_anew(READY)
    first, end = spoken.due()
    assert isinstance(first, Audio)
    assert (first.start, len(first.pcm)) == (0, 2 * (24_000 - 12_800))
    assert end == End(seg=1)


def test_what_was_flushed_did_not_come_back_and_what_was_interrupted_is_not_said_again() -> None:
    spoken = Spoken(AudioFormat())
    spoken.add(bytes(20_000), end=False)
    list(spoken.due())
    spoken.hear(sound(0, 1))
    spoken.flush(Flush(at=0, epoch=1, seg=0, heard=0))
    assert spoken.received == 0
    spoken.interrupt()
    spoken.begin_anew(READY)
    assert list(spoken.due()) == []
    assert spoken.add(b"", end=True) == 2


def test_old_utterances_are_forgotten() -> None:
    spoken = Spoken(AudioFormat())
    for _ in range(20):
        spoken.add(bytes(2), end=True)
        list(spoken.due())
    assert len(spoken._said) == KEPT
