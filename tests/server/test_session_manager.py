"""Who comes in, who comes back, and how it ends."""

import asyncio
import contextlib
import dataclasses
import gc
import platform
import resource
import threading
import time
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.engine.fakes import Heard
from tests.server.fakes import FAST, Body, serving
from websockets.exceptions import ConnectionClosed

from echoavatar.engine import Engine
from echoavatar.server import session_manager
from echoavatar.server.outbox import Outbox
from echoavatar.server.session_manager import SessionManager
from echoavatar.server.settings import ServerSettings
from echoavatar.server.waiting import MOST, PATIENCE_S, RETRY_S
from echoavatar.wire.blobs import pack_audio
from echoavatar.wire.codec import ProtocolError, encode
from echoavatar.wire.messages import Audio, Error, Hello, Motion, Sound


def test_the_oldest_lost_session_makes_room_for_a_newcomer() -> None:
    patient = dataclasses.replace(FAST, resume_seconds=60.0)
    with serving(seats=2, settings=patient) as server, server.call(Hello()) as lost, server.call(Hello()) as stays:
        lost.until(Motion)
        lost.line.socket.close()
        time.sleep(0.2)
        with server.call(Hello()) as newcomer:
            newcomer.until(Motion)
        stays.until(Motion)
        assert lost.ready.session not in server.manager._sessions


def refusal(manager: SessionManager, ticket: str) -> tuple[int, float]:
    """The place in the queue that a client is told, and when to come back."""
    with pytest.raises(ProtocolError) as caught:
        manager.enter(Hello(ticket=ticket), Outbox())
    assert caught.value.code == "overloaded"
    return caught.value.place, caught.value.retry_after


async def test_who_waits_before_a_full_server_keeps_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    manager, real, ahead = SessionManager(Engine(Body(), seats=1), ServerSettings()), time.monotonic, 0.0  # type: ignore[arg-type]
    monkeypatch.setattr(time, "monotonic", lambda: real() + ahead)
    seated, box = [], Outbox()
    seated.append(manager.enter(Hello(), box))
    assert refusal(manager, "") == (0, 5.0)  # no ticket, no place
    assert [refusal(manager, name)[0] for name in ("ann", "ben", "ann", "cem")] == [1, 2, 1, 3]
    manager.end(seated[0])
    assert refusal(manager, "") == (0, 5.0)
    assert refusal(manager, "ben") == (2, RETRY_S)
    second = manager.enter(Hello(ticket="ann"), Outbox())
    assert refusal(manager, "ben") == (1, RETRY_S)
    ahead = PATIENCE_S + 0.1  # ben and cem have gone
    manager.end(second)
    manager.enter(Hello(), Outbox())


async def test_who_comes_beyond_what_the_machine_carries_is_told_so_and_nobody_ends_for_it() -> None:
    manager = SessionManager(Engine(Body(), seats=8, workers=1), ServerSettings())  # type: ignore[arg-type]
    manager.engine._capacity.note(0.09, 1)  # twice within 0.7 of a chunk's time
    box = Outbox()
    lost, stays = manager.enter(Hello(), box), manager.enter(Hello(), Outbox())
    with pytest.raises(ProtocolError, match="carries 2 sessions") as caught:
        manager.enter(Hello(), Outbox())
    assert (caught.value.code, caught.value.retry_after) == ("overloaded", 5.0)
    assert b"echoavatar_room 2.0" in manager.metrics.text()
    manager.leave(lost, box, for_good=False)
    manager.engine._capacity.note(1.0, 1)  # now it carries one, and without the lost one it has no room either
    assert refusal(manager, "ann") == (1, RETRY_S)
    assert manager.names == (lost.name, stays.name)
    manager.end(stays)
    assert manager.enter(Hello(ticket="ann"), Outbox()).name == manager.names[-1]
    assert lost.name not in manager.names


async def test_a_flood_of_tickets_takes_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    manager = SessionManager(Engine(Body(), seats=1), ServerSettings())  # type: ignore[arg-type]
    manager.enter(Hello(), Outbox())
    places = [refusal(manager, str(number))[0] for number in range(MOST + 50)]
    assert places == [min(number, MOST) + 1 for number in range(MOST + 50)]
    assert len(manager._waiting._seen) == MOST


def test_a_server_that_stops_lets_the_sentence_end() -> None:
    with serving(settings=dataclasses.replace(FAST, drain_seconds=8.0)) as server, server.call(Hello()) as caller:
        caller.speak(1, np.full(24_000, 0.2, np.float32))
        caller.until(Motion)
        server.uvicorn.should_exit = True
        code, error = caller.closing()
        told = [message for message in caller.heard if isinstance(message, Error)]
        sounds = [np.frombuffer(m.pcm, "<i2") for m in caller.heard if isinstance(m, Sound)]
    assert code == 1012
    assert error is not None
    assert [message.fatal for message in told] == [False, True]
    assert np.count_nonzero(np.concatenate(sounds)) == 24_000


def test_an_engine_that_breaks_is_restarted_and_its_clients_are_told() -> None:
    """Health is red meanwhile; motion goes on without a hole."""
    loading = threading.Event()

    def load() -> Any:
        loading.wait(10)
        return Body()

    with serving() as server, server.call(Hello()) as caller:
        caller.until(Motion)
        server.manager.engine._reload = load
        server.manager.engine.pipeline.seconds = "not a number of seconds"
        end = time.monotonic() + 5
        while server.http("/health")[0] == 200 and time.monotonic() < end:
            time.sleep(0.02)
        status, facts = server.http("/health")
        assert (status, facts["status"]) == (503, "restarting")
        loading.set()
        told = caller.until(Error)
        at = caller.until(Motion).at
        assert (told.code, told.fatal) == ("internal", False)
        assert "resumed" in told.message
        caller.until(Motion, lambda motion: motion.at > at)
        assert np.all(np.diff([message.at for message in caller.heard if isinstance(message, Sound)]) == 6_400)
        assert server.http("/health")[0] == 200
        assert "echoavatar_engine_restarts_total 1.0" in server.http("/metrics")[1]


def test_a_session_with_a_fault_is_lost_alone() -> None:
    with serving() as server, server.call(Hello()) as caller, server.call(Hello()) as neighbour:
        caller.until(Motion)
        server.manager.find(caller.ready.session).core._gaze = None  # a stage of this session alone
        code, error = caller.closing()
        at = neighbour.until(Motion).at
        neighbour.until(Motion, lambda motion: motion.at > at + 12_800)
        assert server.manager.is_well
        assert "echoavatar_session_faults_total 1.0" in server.http("/metrics")[1]
    assert code == 1011
    assert error is not None
    assert "lost" in error.message


def test_an_engine_that_cannot_be_healed_ends_the_server(caplog: pytest.LogCaptureFixture) -> None:
    with serving() as server, server.call(Hello()) as caller:
        caller.until(Motion)
        server.manager.engine.pipeline.seconds = "not a number of seconds"
        assert caller.closing()[0] in (1011, 1012)  # the session's end or the server's, whichever is first
        server.thread.join(10)
        assert not server.thread.is_alive()
        assert isinstance(server.manager.failure, TypeError)
    assert "the engine stopped" in caplog.text


def test_a_stopping_house_lets_nobody_in() -> None:
    manager = SessionManager(Engine(Body()), FAST)  # type: ignore[arg-type]
    manager.is_draining = True
    with pytest.raises(ProtocolError) as caught:
        manager.enter(Hello(), Outbox())
    assert caught.value.code == "shutting_down"
    assert manager.sessions == 0


async def test_a_lost_source_may_come_back_for_half_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock is set forward by 25 s, and by 10 more."""
    manager, real, ahead = SessionManager(Engine(Body()), ServerSettings()), time.monotonic, 0.0  # type: ignore[arg-type]
    monkeypatch.setattr(time, "monotonic", lambda: real() + ahead)
    running, outbox = asyncio.create_task(manager.run()), Outbox()
    session = manager.enter(Hello(), outbox)
    manager.leave(session, outbox, for_good=False)
    left = []
    for seconds in (0.0, 25.0, 35.0):
        ahead = seconds
        for _ in range(5):
            await asyncio.sleep(0.03)
        left.append(manager.sessions)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert left == [1, 1, 0]


async def test_two_minutes_of_speech_may_wait() -> None:
    manager = SessionManager(Engine(Body()), ServerSettings())  # type: ignore[arg-type]
    session, minute = manager.enter(Hello(), Outbox()), pack_audio(np.zeros(59 * 24_000, np.float32))
    for part in range(2):
        session.hear(Audio(seg=1, start=59 * 24_000 * part, pcm=minute))
    with pytest.raises(ProtocolError, match="waiting") as caught:
        session.hear(Audio(seg=1, start=2 * 59 * 24_000, pcm=minute))
    assert caught.value.code == "inbox_full"


def test_a_session_that_is_over_leaves_no_cycle_behind() -> None:
    """Without the garbage collector: sessions go with their clients, and so does what waited to be sent."""
    gone: list[weakref.ref[object]] = []
    boxes: list[Any] = []
    with serving(settings=FAST) as server:
        gc.collect()
        gc.disable()
        try:
            for _ in range(5):
                with server.call(Hello()) as caller:
                    caller.speak(1, np.full(48_000, 0.2, np.float32))
                    caller.until(Motion)
                    session = list(server.manager._sessions.values())[-1]  # the one before may still be closing
                    gone += [weakref.ref(session), weakref.ref(session.core)]
                    boxes.append(session.source)
                    del session
            assert server.empties()
            end = time.monotonic() + 5
            while any(one() is not None for one in gone) and time.monotonic() < end:
                time.sleep(0.05)
            assert [one() for one in gone] == [None] * len(gone)
            assert [len(box) for box in boxes] == [0] * len(boxes)
        finally:
            gc.enable()


def test_a_flood_of_one_sample_utterances_holds_nobody_up() -> None:
    """20,000 messages; a neighbour's motion comes on time until the flood is refused, in words.

    On time by this process's own seconds on the processor: those of other processes are not the flood's.
    """
    with serving(settings=FAST) as server, server.call(Hello()) as neighbour, server.call(Hello()) as flood:
        refused = []

        def send() -> None:
            with contextlib.suppress(ConnectionClosed):
                for seg in range(1, 20_001):
                    flood.line.send(encode(Audio(seg=seg, start=0, pcm=b"\1\0")))
            refused.append(flood.closing(60)[1])

        sender = threading.Thread(target=send)
        sender.start()
        began, at = time.process_time(), neighbour.until(Motion).at
        while sender.is_alive():
            last = neighbour.until(Motion).at
            assert (time.process_time() - began) - (last - at) / 24_000 < 1.0
        (error,) = refused
    assert error is not None
    assert error.code == "inbox_full"


def test_freed_memory_is_given_back_while_the_server_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    given = threading.Event()
    monkeypatch.setattr(session_manager, "TRIM_S", 0.1)
    monkeypatch.setattr(session_manager, "give_back", given.set)
    with serving():
        assert given.wait(5)


def test_a_session_is_advanced_for_a_reason_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its chunk is made, and its next one is due: about twice a chunk, and once more for each thing that is said.

    A timer may fire a little early, and is set again; a clock of 20 ms would be 13 times a chunk.
    """
    advanced, advance = [], SessionManager._advance

    def counted(manager: SessionManager, session: Any) -> None:
        advanced.append(session)
        advance(manager, session)

    monkeypatch.setattr(SessionManager, "_advance", counted)
    with serving() as server, server.call(Hello()) as caller:
        last = caller.until(Motion, lambda motion: motion.at >= 48_000)
        count = len(advanced)
    assert count <= 6 * (last.at // 6_400 + 1)


def test_speech_in_silence_is_answered_before_the_silence_that_is_scheduled_has_been_played() -> None:
    """Its sound wakes the session; no clock has to tick first."""
    with serving() as server, server.call(Hello()) as caller:
        at = caller.until(Motion, lambda motion: motion.at >= 12_800).at
        caller.speak(1, np.full(12_800, 0.2, np.float32))
        began = time.monotonic()
        caller.until(Sound, lambda sound: sound.seg == 1)
        assert time.monotonic() - began < 0.5
        assert [message.at for message in caller.heard if isinstance(message, Sound) and message.seg == 1][
            0
        ] <= at + 12_800


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps what is freed")
def test_free_pages_between_blocks_in_use_go_back() -> None:
    blocks = [np.ones(12_000, np.uint8) for _ in range(10_000)]
    kept = blocks[::5]
    before = resident()
    del blocks
    session_manager.give_back()
    assert before - resident() > 40e6
    assert len(kept) == 2_000


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctypes.CDLL", lambda name: object())
    session_manager.give_back()


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def test_in_a_batch_all_go_with_the_one_that_is_due() -> None:
    """Sessions that began at different moments are made in the same steps."""

    class Counting(Body):
        active: list[int] = []

        def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> Any:
            self.active.append(int(active.sum()))
            return super().step(audio, state, active)

    pipeline = Counting()
    with serving(pipeline=pipeline, workers=0) as server, server.call(Hello()) as first:
        first.until(Motion, lambda motion: motion.at >= 6_400)
        time.sleep(0.1)
        with server.call(Hello()) as second:
            second.until(Motion, lambda motion: motion.at >= 48_000)
    assert np.mean(np.array(pipeline.active[-8:]) == 2) > 0.5
