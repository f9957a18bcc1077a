import asyncio

import pytest

from echoavatar.server.outbox import Outbox, Relay
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.messages import Error, Flush, Motion, Pong, Sound


def motion(at: int, frames: int = 8) -> Motion:
    return Motion(at=at, epoch=0, frames=frames, rotations=b"", root=b"", face=b"", state="idle")


def sound(at: int) -> Sound:
    return Sound(at=at, epoch=0, seg=0, pcm=b"")


def drain(box: Outbox) -> list[object]:
    async def run() -> list[object]:
        box.close()
        out = []
        while (message := await box.take()) is not None:
            out.append(message)
        return out

    return asyncio.run(run())


CHUNKS = pytest.mark.parametrize("frames", [4, 8])  # of the default bundle, of the paper


@CHUNKS
def test_a_slow_connection_loses_motion_older_than_four_seconds_and_no_sound(frames: int) -> None:
    box, size = Outbox(), frames * 800
    clock = range(0, 240_000, size)  # ten seconds
    for at in clock:
        box.put(motion(at, frames))
        box.put(sound(at))
    left = drain(box)
    assert [m.at for m in left if isinstance(m, Motion)] == [at for at in clock if at >= clock[-1] - 96_000]
    assert box.dropped == len(clock) - 96_000 // size - 1
    assert [s.at for s in left if isinstance(s, Sound)] == list(clock)


@CHUNKS
def test_a_connection_that_cannot_carry_the_sound_is_given_up(frames: int) -> None:
    """Thirty seconds of sound may wait, a minute may not."""
    box, size = Outbox(), frames * 800
    for at in range(0, 30 * 24_000, size):
        box.put(sound(at))
    assert not box.is_hopeless
    for at in range(30 * 24_000, 60 * 24_000, size):
        box.put(sound(at))
    assert box.is_hopeless
    assert len(box) < 45 * 24_000 / size


def test_a_client_that_reads_no_answers_is_given_up() -> None:
    box = Outbox()
    for nonce in range(400):
        box.put(Pong(nonce=nonce, at=0))
    assert not box.is_hopeless
    for nonce in range(400):
        box.put(Pong(nonce=nonce, at=0))
    assert box.is_hopeless


def test_only_what_is_wanted_is_sent() -> None:
    box = Outbox(("motion",))
    box.put(sound(0))
    box.put(motion(0))
    box.put(Pong(nonce=1, at=0))
    assert [type(m) for m in drain(box)] == [Motion, Pong]
    assert not Outbox(()).plays


def test_what_was_taken_back_is_not_sent() -> None:
    box = Outbox()
    for at in (0, 6_400, 12_800):
        box.put(motion(at))
        box.put(sound(at))
    box.forget_after(6_400)
    assert [m.at for m in drain(box)] == [0, 0]  # type: ignore[attr-defined]


def test_the_reason_is_the_last_message() -> None:
    box = Outbox()
    box.fail(ProtocolError("replaced", "gone"))
    box.put(motion(0))
    (last,) = drain(box)
    assert last == Error(code="replaced", message="gone", fatal=True, retry_after=0.0)
    assert box.error is not None


def test_an_empty_box_is_waited_for() -> None:
    async def run() -> object:
        box = Outbox()
        waiting = asyncio.create_task(box.take())
        await asyncio.sleep(0)
        box.put(Pong(nonce=1, at=0))
        return await waiting

    assert asyncio.run(run()) == Pong(nonce=1, at=0)


def test_a_relay_passes_messages_at_once_and_plays_only_with_a_source() -> None:
    """A source that returns finds its session where it left it, so nobody else may move the clock on."""
    told: list[object] = []
    sources: list[object] = []
    relay = Relay(told.append, lambda: bool(sources), lambda: told.append("end"))
    assert not relay.plays
    sources.append(object())
    assert relay.plays
    relay.put(Flush(at=1, epoch=1, seg=0, heard=0))
    assert len(relay) == 0
    relay.close()
    assert [type(one).__name__ for one in told] == ["Flush", "str"]
