"""A real server on a real port, and hostile clients: each gets its answer and harms no other."""

import asyncio
import dataclasses
import time
from collections.abc import Iterator
from unittest.mock import Mock

import anyio
import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.server.fakes import FAST, RunningServer, serving

from echoavatar.server.connection import Connection
from echoavatar.wire.blobs import pack_audio
from echoavatar.wire.codec import decode_server, encode
from echoavatar.wire.messages import (
    Action,
    ActionStatus,
    Audio,
    AudioFormat,
    ClientMessage,
    End,
    Error,
    Flush,
    Hello,
    Interrupt,
    Motion,
    Music,
    Ping,
    Played,
    Pong,
    Ready,
    Sound,
    State,
    Stats,
)


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with serving(seats=6, settings=dataclasses.replace(FAST, hello_seconds=2.0, resume_seconds=2.0)) as server:
        yield server


def is_unharmed(server: RunningServer) -> None:
    """A newcomer is served, and the engine moves."""
    with server.call(Hello()) as caller:
        caller.until(Motion)
        caller.say(Ping(nonce=5))
        assert caller.until(Pong).nonce == 5


def test_a_session_from_hello_to_goodbye(server: RunningServer) -> None:
    with server.call(Hello()) as caller:
        assert caller.ready.rig.names[0] == "hips"
        assert caller.ready.actions == ("wave", "bow")
        caller.speak(1, np.full(12_000, 0.2, np.float32))
        caller.say(End(seg=1))
        done = caller.until(State, lambda state: state.finished == 1)
        assert 12_000 <= done.at <= 48_000
        assert any(isinstance(message, Stats) for message in caller.heard) or caller.until(Stats)
        caller.say(Action(id="x", name="wave"))
        caller.until(ActionStatus, lambda status: status.status == "done")
        caller.say(Music(id="m", op="play", title="nothing"))
        assert "Evening Waltz" in caller.until(ActionStatus, lambda status: status.id == "m").choices
    assert server.empties()


def test_an_interruption_over_the_wire(server: RunningServer) -> None:
    with server.call(Hello()) as caller:
        caller.speak(1, np.full(96_000, 0.2, np.float32))
        caller.until(Sound, lambda sound: sound.seg == 1)
        began = time.monotonic()
        caller.say(Interrupt())
        flush = caller.until(Flush)
        motion = caller.until(Motion)
        assert time.monotonic() - began < 2  # of four seconds of speech
        assert (motion.at, motion.epoch) == (flush.at, flush.epoch)


def test_the_json_encoding_carries_the_same_messages(server: RunningServer) -> None:
    from websockets.sync.client import connect

    with connect(f"ws://{server.address}/v1/stream", subprotocols=["echoavatar.v1.json"]) as line:  # type: ignore[list-item]
        assert line.subprotocol == "echoavatar.v1.json"
        line.send('{"type":"hello"}')
        kinds: set[type] = set()
        for _ in range(20):  # statistics may come in between
            kinds.add(type(decode_server(line.recv(timeout=10), "json")))
            if {Ready, Motion, Sound} <= kinds:
                break
        assert {Ready, Motion, Sound} <= kinds


@pytest.mark.parametrize(
    ("frame", "code"),
    [
        (b"\xc1 nonsense", 4400),
        (msgspec.msgpack.encode({"type": "motion", "at": 0}), 4400),
        (msgspec.msgpack.encode({"type": "audio", "seg": "one"}), 4400),
        (encode(Ping())[:-1], 4400),
        (encode(Hello()), 4400),
        ("text where bytes were agreed on", 4400),
        (bytes(9_000_000), 1009),
    ],
    ids=["garbage", "motion", "wrong type", "truncated", "second hello", "text", "huge"],
)
def test_hostile_messages_end_only_their_own_connection(server: RunningServer, frame: bytes | str, code: int) -> None:
    with server.call(Hello()) as neighbour, server.call(Hello()) as caller:
        caller.line.send(frame)
        closed, error = caller.closing()
        assert closed == code
        assert error is not None
        at = neighbour.until(Motion).at
        assert neighbour.until(Motion).at > at


@pytest.mark.parametrize("message", [Ping(), End(seg=1), Audio(seg=1, start=0, pcm=b"")])
def test_hello_comes_first(server: RunningServer, message: ClientMessage) -> None:
    with server.call() as caller:
        caller.say(message)
        assert caller.closing()[0] == 4400


def test_a_client_without_hello_is_closed(server: RunningServer) -> None:
    with server.call() as caller:
        code, error = caller.closing()
    assert code == 4408
    assert error is not None
    assert error.code == "timeout"


def test_invalid_sound_is_reported_and_dropped(server: RunningServer) -> None:
    with server.call(Hello(audio=AudioFormat(format="f32le"))) as caller:
        bad = np.array([0.1, np.nan, np.inf], "<f4").tobytes()
        caller.say(Audio(seg=1, start=0, pcm=bad))
        assert caller.until(Error).code == "bad_audio"
        caller.say(Audio(seg=1, start=0, pcm=b"\0\0\0"))
        assert caller.until(Error).code == "bad_audio"
        caller.say(Audio(seg=1, start=7, pcm=np.zeros(8, "<f4").tobytes()))
        assert caller.until(Error).code == "bad_order"
        caller.say(Audio(seg=1, start=0, pcm=np.full(6_400, 0.5, "<f4").tobytes()))
        caller.until(Sound, lambda sound: sound.seg == 1)


def test_a_minute_of_sound_may_come_in_one_message(server: RunningServer) -> None:
    for seconds, rate in ((18, 24_000), (60, 48_000)):
        with server.call(Hello(audio=AudioFormat(rate=rate))) as caller:
            caller.say(Audio(seg=1, start=0, pcm=bytes(2 * rate * seconds)))
            caller.until(Sound, lambda sound: sound.seg == 1)


def test_too_many_errors_end_the_connection(server: RunningServer) -> None:
    with server.call(Hello()) as caller:
        for _ in range(120):
            caller.say(Audio(seg=1, start=999, pcm=b""))
        assert caller.closing()[0] == 4400


def lateness_beside_a_flood(server: RunningServer) -> float:
    """How many seconds a neighbour's motion falls behind the wall clock from a flood's begin on."""
    long = np.zeros(24_000 * 20, np.float32)
    with server.call(Hello()) as neighbour, server.call(Hello()) as flood:
        at, began = neighbour.until(Motion).at, time.monotonic()
        for k in range(12):
            flood.speak(1, long, start=k * len(long))
        assert flood.until(Error).code == "inbox_full"
        neighbour.say(Ping(nonce=1))
        neighbour.until(Pong)  # what was sent during the flood is read
        for _ in range(4):
            last = neighbour.until(Motion).at
        return (time.monotonic() - began) - (last - at) / 24_000


def test_a_flood_is_refused_and_other_sessions_stay_on_time(server: RunningServer) -> None:
    """A busy machine may be late by itself, a harmful flood is late every time."""
    assert any(lateness_beside_a_flood(server) < 1.0 for _ in range(3))


def test_versions_are_agreed_on(server: RunningServer) -> None:
    with server.call() as caller:
        caller.say(Hello(versions=(7, 8)))
        assert caller.closing()[0] == 4426
    with server.call(Hello(versions=(1, 2))) as caller:
        assert caller.ready.version == 1


def test_unknown_sessions_are_refused(server: RunningServer) -> None:
    for hello in (Hello(resume="nothing"), Hello(role="viewer", session="nothing")):
        with server.call() as caller:
            caller.say(hello)
            assert caller.closing()[0] == 4404


def test_wrong_origins_are_refused(server: RunningServer) -> None:
    with server.call(additional_headers={"Origin": "https://evil.example"}) as caller:
        assert caller.closing()[0] == 4403
    with server.call(Hello(), additional_headers={"Origin": f"http://{server.address}"}) as caller:
        caller.until(Motion)


def test_a_message_that_cannot_be_written_is_left_out_and_ends_no_connection(server: RunningServer) -> None:
    with server.call(Hello()) as source, server.call(Hello(role="viewer", session=source.ready.session)) as viewer:
        session = server.manager.find(source.ready.session)
        assert session.core.act("wave\ud83d").status == "rejected"  # all clients are told the name
        source.speak(1, np.full(24_000, 0.2, np.float32))
        for client in (source, viewer):
            client.until(Sound, lambda sound: sound.seg == 1)


def test_viewers_watch_and_send_no_sound(server: RunningServer) -> None:
    with server.call(Hello()) as source:
        source.speak(1, np.full(48_000, 0.2, np.float32))
        source.until(Sound, lambda sound: sound.seg == 1)
        with server.call(Hello(role="viewer", session=source.ready.session)) as viewer:
            assert viewer.ready.resume == ""
            first = viewer.until(Motion)
            assert first.at == viewer.ready.at
            viewer.say(Interrupt())
            assert source.until(Flush).epoch == 1
            viewer.speak(1, np.zeros(10, np.float32))
            assert viewer.closing()[0] == 4400
        source.until(Motion)


def test_a_lost_source_resumes_its_session(server: RunningServer) -> None:
    with server.call(Hello(seed=3)) as lost:
        lost.speak(1, np.full(24_000, 0.2, np.float32))
        sound = lost.until(Sound, lambda sound: sound.seg == 1)
        lost.line.socket.close()
        time.sleep(0.2)
        back = server.call(Hello(resume=lost.ready.resume, played=sound.at))
    with back:
        assert back.ready.resumed
        assert back.ready.session == lost.ready.session
        assert (back.ready.seg, back.ready.received) == (1, 24_000)
        again = back.until(Sound)
        assert again == sound
        back.speak(1, np.full(2_400, 0.2, np.float32), start=24_000)
        back.say(End(seg=1))
        back.until(State, lambda state: state.finished == 1)
        with server.call(Hello(resume=back.ready.resume)) as other:
            assert other.ready.resumed
            assert back.closing()[0] == 4409


def test_a_source_that_is_lost_as_it_interrupts_is_told_the_flush_when_it_resumes(server: RunningServer) -> None:
    """Else it would play what was taken back, or take the new motion for motion that it has."""
    with server.call(Hello(seed=3)) as lost:
        lost.speak(1, np.full(72_000, 0.2, np.float32))
        sound = lost.until(Sound, lambda sound: sound.seg == 1)
        received, epoch = sound.at + 12_800, lost.ready.epoch
        lost.say(Interrupt(heard=sound.at + 1_600, seg=1))
        lost.until(Flush)  # as if this had not arrived
        lost.line.socket.close()
        time.sleep(0.2)
        back = server.call(Hello(resume=lost.ready.resume, played=received, epoch=epoch))
    with back:
        flush = back.next()
        assert isinstance(flush, Flush)
        assert (flush.seg, flush.epoch) == (1, back.ready.epoch)
        assert sound.at + 1_600 <= flush.at < received
        assert back.until(Sound).at <= flush.at
        with server.call(Hello(resume=back.ready.resume, played=back.ready.at, epoch=back.ready.epoch)) as again:
            assert not isinstance(again.next(), Flush)


def test_a_resume_key_is_spent_once_its_successor_is_known_to_have_arrived(server: RunningServer) -> None:
    with server.call(Hello(seed=3)) as first:
        old = first.ready.resume
    keys = [old]
    with server.call(Hello(seed=4)) as lost:
        keys.append(lost.ready.resume)
        lost.line.socket.close()
        time.sleep(0.2)
        for _ in range(2):  # `ready` was lost on the way: the key still serves
            torn = server.call(Hello(resume=keys[1]))
            keys.append(torn.ready.resume)
            torn.line.socket.close()
            time.sleep(0.2)
        with server.call(Hello(resume=keys[-1])) as back:
            keys.append(back.ready.resume)
            back.say(Ping(nonce=1))
            back.until(Pong)
            assert len(set(keys)) == len(keys)
            for spent in keys[:-1]:
                with server.call() as thief:
                    thief.say(Hello(resume=spent))
                    assert thief.closing()[0] == 4404
            back.say(Ping(nonce=2))
            back.until(Pong, lambda pong: pong.nonce == 2)  # nobody took its place


def test_a_resume_key_cannot_be_guessed(server: RunningServer) -> None:
    """It is random, of 192 bits; a key that differs by one letter, part of one, or a public name opens nothing."""
    import base64

    with server.call(Hello(seed=1)) as one, server.call(Hello(seed=1)) as two:
        key = one.ready.resume
        bits = [np.unpackbits(np.frombuffer(base64.urlsafe_b64decode(of.ready.resume), np.uint8)) for of in (one, two)]
        assert [len(row) for row in bits] == [192, 192]
        assert 60 < (bits[0] != bits[1]).sum() < 132  # the same hello, and half of the bits differ (five sigmas)
        other = next(letter for letter in "ABC" if letter not in (key[0], key[-1]))
        guesses = [key[:-1] + other, other + key[1:], key[:-1], key + "A", key.swapcase(), one.ready.session, " " + key]
        for guess in guesses:
            with server.call() as thief:
                thief.say(Hello(resume=guess))
                assert thief.closing()[0] == 4404
        one.say(Ping(nonce=1))
        one.until(Pong)  # still there


def test_a_resume_key_opens_nothing_without_the_token_that_the_session_began_with() -> None:
    with serving(settings=dataclasses.replace(FAST, token="secret")) as server:
        with server.call(Hello(token="secret")) as owner:
            key = owner.ready.resume
            for token in ("", "guess", key):
                with server.call() as thief:
                    thief.say(Hello(token=token, resume=key))
                    assert thief.closing()[0] == 4401
            owner.say(Ping(nonce=1))
            owner.until(Pong)
        with server.call(Hello(token="secret")) as owner:
            owner.line.socket.close()
            time.sleep(0.2)
            with server.call(Hello(token="secret", resume=owner.ready.resume)) as back:
                assert back.ready.resumed


def test_a_lost_session_expires(server: RunningServer) -> None:
    caller = server.call(Hello())
    caller.line.socket.close()
    time.sleep(2.5)
    with server.call() as late:
        late.say(Hello(resume=caller.ready.resume))
        assert late.closing()[0] == 4404


def test_seats_are_freed_when_many_clients_come_and_go(server: RunningServer) -> None:
    """Most are refused at the door for want of seats, some leave mid-sentence; the server does not mind."""
    with server.call(Hello()) as neighbour:
        for k in range(24):
            caller = server.call()
            if k % 3 == 0:
                caller.say(Hello())
            if k % 5 == 0:
                caller.line.socket.close()
            else:
                caller.line.close()
        neighbour.until(Motion)
        at = neighbour.until(Motion).at
        assert neighbour.until(Motion).at > at
    assert server.empties()
    assert server.manager.engine.free == 6
    is_unharmed(server)


def test_more_sessions_than_seats_are_refused_with_a_time(server: RunningServer) -> None:
    callers = [server.call(Hello()) for _ in range(6)]
    with server.call() as late:
        late.say(Hello())
        code, error = late.closing()
        assert code == 4429
        assert error is not None
        assert error.retry_after > 0
    for caller in callers:
        caller.line.close()
    assert server.empties()
    is_unharmed(server)


samples = st.integers(0, 2**53 - 1)
anything = st.one_of(
    st.builds(
        Audio,
        seg=st.integers(1, 4),
        start=st.sampled_from([0, 0, 100, 6_400, 2**53 - 1]),
        pcm=st.sampled_from([b"", b"\0", bytes(200), bytes(20_000), pack_audio(np.ones(9_000, np.float32))]),
        speaker=st.sampled_from(["avatar", "user"]),
    ),
    st.builds(End, seg=st.integers(1, 4), speaker=st.sampled_from(["avatar", "user"])),
    st.builds(Interrupt, heard=st.none() | samples | st.integers(0, 100_000), seg=st.integers(0, 5)),
    st.builds(Action, id=st.sampled_from("abc"), name=st.sampled_from(["wave", "bow", "fly", ""])),
    st.builds(Music, id=st.just("m"), op=st.just("stop")),
    st.builds(Played, at=samples | st.integers(0, 100_000), epoch=st.integers(0, 3)),
    st.builds(Ping),
)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(talk=st.lists(anything, max_size=25))
def test_any_order_of_valid_messages_is_accepted(server: RunningServer, talk: list[ClientMessage]) -> None:
    """What comes back is in order: motion without holes within an epoch, epochs that grow."""
    with server.call(Hello()) as caller:
        for message in talk:
            caller.say(message)
        caller.say(Ping(nonce=77))
        caller.until(Pong, lambda pong: pong.nonce == 77)
        caller.until(Motion)
        epoch, expected = 0, 0
        for message in caller.heard:
            if isinstance(message, Flush):
                assert message.epoch > epoch
                epoch, expected = message.epoch, min(message.at, expected)
            elif isinstance(message, Motion):
                assert (message.epoch, message.at) == (epoch, expected)
                expected += message.frames * 800
            elif isinstance(message, Error):
                assert not message.fatal


async def test_minutes_of_the_users_sound_are_heard_by_the_second_and_others_get_their_turn_between() -> None:
    connection, order = Connection(Mock(scope={}), Mock()), list[tuple[int, int] | None]()
    connection._form = AudioFormat(rate=8_000)

    async def other() -> None:
        while True:
            order.append(None)
            await asyncio.sleep(0)

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(other)
        session = Mock(hear=lambda part: order.append((part.start, len(part.pcm))))
        await connection._hear(session, Audio(seg=1, start=100, pcm=bytes(40_000), speaker="user"))
        tasks.cancel_scope.cancel()
    assert [part for part in order if part] == [(100, 16_000), (8_100, 16_000), (16_100, 8_000)]
    assert all(one is None or following is None for one, following in zip(order, order[1:], strict=False))
