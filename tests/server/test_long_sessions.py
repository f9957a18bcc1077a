"""A session that idles for a day and more, on a hand-wound clock: it stays small, on time and alive.

Also clocks that jump: a computer that sleeps, a process that is stopped.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.server.rooms import Room

from echoavatar.engine.session_core import SessionCore
from echoavatar.timing import CHUNK_SAMPLES, CHUNK_SECONDS, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME
from echoavatar.wire.blobs import unpack_pose
from echoavatar.wire.codec import decode_server, encode
from echoavatar.wire.messages import End, Flush, Interrupt, Motion, Played, Sound

HOUR_S = 3_600
OLD = 30 * HOUR_S * SAMPLE_RATE_HZ // CHUNK_SAMPLES  # chunks of 30 hours, more than 2^31 samples


def held(thing: Any, seen: set[int] | None = None) -> int:
    """How many things and bytes of arrays an object of ours holds on to."""
    seen = set() if seen is None else seen
    if id(thing) in seen or callable(thing):
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return int(thing.nbytes)
    if isinstance(thing, dict):
        return sum(held(each, seen) for pair in thing.items() for each in pair)
    if isinstance(thing, list | tuple | set | frozenset | deque):
        return len(thing) + sum(held(each, seen) for each in thing)
    if isinstance(thing, bytes | str):
        return len(thing)
    if type(thing).__module__.startswith("echoavatar"):
        slots = [getattr(thing, name, None) for name in getattr(type(thing), "__struct_fields__", ())]
        return 1 + held(slots, seen) + held(getattr(thing, "__dict__", {}), seen)
    return 1


def size(room: Room) -> int:
    """What a session and its engine hold, but for the test's own list of messages."""
    room.box.told.clear()
    return held([room.session, room.engine])


def grow_old(core: SessionCore, chunks: int) -> None:
    """Let a fresh session stand where one that is so many chunks old stands."""
    core._queue._next = core._queue._scheduled = core._barge_in._made = core._music._chunk = chunks
    core._playout.taken = core._playout.end = chunks * CHUNK_SAMPLES


def old_room(chunks: int = OLD) -> Room:
    room = Room()
    grow_old(room.session.core, chunks)
    room.session.end = chunks * CHUNK_SAMPLES
    room.session.pacer.playhead.jump(room.session.end)
    return room


def idle(room: Room, seconds: float) -> None:
    """As a browser does: it reports its place four times a second."""
    for _ in range(round(seconds / CHUNK_SECONDS)):
        room.go(CHUNK_SECONDS, step=CHUNK_SECONDS)
        room.session.played(Played(at=room.session.place), room.box)


def check_idling(room: Room, minutes: int, seconds: float) -> None:
    """Nothing grows, no chunk is still, and the session is where the clock says."""
    idle(room, 20)  # more than is remembered of anything
    before, began, at = size(room), room.now, room.session.place
    for _ in range(minutes):
        idle(room, seconds)
        poses = [unpack_pose(message).rotations for message in room.box.of(Motion)]
        moved = [np.ptp(rotations, axis=0).max() for rotations in poses]
        assert len(moved) == pytest.approx(seconds / CHUNK_SECONDS, abs=1)
        assert min(moved) > 3e-5, "two units of the wire, in the chunk between two breaths"
        steps = [np.abs(np.diff(rotations, axis=0)).max() for rotations in poses]
        assert max(steps) < 0.01, "no joint is faster than 34 degrees a second, a quick look's"
        assert size(room) < 1.01 * before
    played = (room.session.place - at) / SAMPLE_RATE_HZ
    assert played == pytest.approx(room.now - began, abs=2 * CHUNK_SECONDS)


@pytest.mark.parametrize("room", [Room, old_room], ids=["new", "thirty hours old"])
def test_idling_leaves_nothing_behind_at_any_age(room: Callable[[], Room]) -> None:
    check_idling(room(), minutes=1, seconds=10)


@pytest.mark.slow
@pytest.mark.parametrize("room", [Room, old_room], ids=["new", "thirty hours old"])
def test_an_hour_of_idling_leaves_nothing_behind_at_any_age(room: Callable[[], Room]) -> None:
    check_idling(room(), minutes=60, seconds=60)


def test_samples_beyond_two_to_the_31_pass_through_every_message() -> None:
    """Speech, a barge-in and a report at the age of thirty hours, to the sample; each message survives the wire."""
    room = old_room()
    begin = room.session.end
    assert begin > 2**31
    room.go(1)
    room.speak(1, 2.0)
    room.session.finish(End(seg=1))
    room.go(1)
    heard = room.session.place
    room.session.interrupt(Interrupt(seg=1, heard=heard))
    room.go(1)
    told = [decode_server(encode(message)) for message in room.box.told]
    assert told == room.box.told
    (flush,) = [message for message in told if isinstance(message, Flush)]
    assert heard <= flush.at < heard + SAMPLES_PER_FRAME
    end, epoch, spoken = begin, 0, 0
    for sound in [message for message in told if isinstance(message, Sound)]:
        end, epoch = (flush.at, sound.epoch) if sound.epoch > epoch else (end, epoch)
        assert sound.at == end
        end += len(sound.pcm) // 2
        spoken += int(np.count_nonzero(np.frombuffer(sound.pcm, "<i2")))
    assert spoken > 0.5 * SAMPLE_RATE_HZ


@pytest.mark.parametrize("reports", [True, False], ids=["player", "no reports"])
@pytest.mark.parametrize("jump_s", [8 * 3_600.0, -3_600.0], ids=["sleeps eight hours", "set back an hour"])
def test_a_clock_that_jumps_makes_no_burst(jump_s: float, reports: bool) -> None:
    """After a computer has slept, a session goes on where it was; it does not make up for the hours."""
    room = Room()
    go = idle if reports else Room.go
    go(room, 5)
    before, usual = room.session.end, len(room.box.of(Motion)) / 5
    room.box.told.clear()
    room.now += jump_s
    room.beat()
    assert len(room.box.told) < 12
    assert room.session.end - before < SAMPLE_RATE_HZ
    go(room, 5)
    assert len(room.box.of(Motion)) == pytest.approx(5 * usual, rel=0.2)
    assert room.session.deadline is not None
    assert room.session.deadline < room.now + 1
