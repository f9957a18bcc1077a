"""Who comes in, who comes back, and how it ends."""

import dataclasses
import time

import numpy as np
import pytest
from echoavatar.server.session_manager import SessionManager
from tests.server.fakes import FAST, Body, serving

from echoavatar.engine import Engine
from echoavatar.server.outbox import Outbox
from echoavatar.wire import Error, Hello, Motion, ProtocolError, Sound


def test_the_oldest_lost_session_makes_room_for_a_newcomer() -> None:
    patient = dataclasses.replace(FAST, resume_seconds=60.0)
    with (
        serving(seats=2, settings=patient) as place,
        place.call(Hello()) as lost,
        place.call(Hello()) as stays,
    ):
        lost.until(Motion)
        lost.line.socket.close()
        time.sleep(0.2)
        with place.call(Hello()) as newcomer:
            newcomer.until(Motion)
        stays.until(Motion)
        assert lost.ready.session not in place.manager._live


def test_a_server_that_stops_lets_the_sentence_end() -> None:
    with (
        serving(settings=dataclasses.replace(FAST, drain_seconds=8.0)) as place,
        place.call(Hello()) as caller,
    ):
        caller.speak(1, np.full(24_000, 0.2, np.float32))
        caller.until(Motion)
        place.server.should_exit = True
        code, error = caller.closing()
        told = [message for message in caller.heard if isinstance(message, Error)]
        sounds = [np.frombuffer(m.pcm, "<i2") for m in caller.heard if isinstance(m, Sound)]
    assert code == 1012
    assert error is not None
    assert [message.fatal for message in told] == [False, True]
    assert np.count_nonzero(np.concatenate(sounds)) == 24_000


def test_a_failing_engine_is_told_and_not_hidden(caplog: pytest.LogCaptureFixture) -> None:
    with serving() as place, place.call(Hello()) as caller:
        caller.until(Motion)
        place.manager.engine.pipeline.seconds = "not a number of seconds"
        assert caller.closing()[0] == 1011
        assert not place.manager.is_well
    assert "the engine stopped" in caplog.text


def test_a_stopping_house_lets_nobody_in() -> None:
    manager = SessionManager(Engine(Body()), FAST)  # type: ignore[arg-type]
    manager.is_draining = True
    with pytest.raises(ProtocolError) as caught:
        manager.enter(Hello(), Outbox())
    assert caught.value.code == "shutting_down"
    assert manager.sessions == 0
