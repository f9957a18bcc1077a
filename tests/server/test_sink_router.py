"""Sinks beside a server's sessions: they show what is heard, and can do no harm."""

import dataclasses
import json
import threading
import time
from typing import Any

import numpy as np
import pytest
from tests.server.fakes import FAST, serving
from tests.server.sinks.receiving import Receiver

from echoavatar.errors import EchoAvatarError
from echoavatar.server import sink_router
from echoavatar.server.sink_router import SinkRouter
from echoavatar.wire.messages import Flush, Hello, Interrupt, Motion, Rig, State


def heights(receiver: Receiver, count: int) -> list[float]:
    found: list[float] = []
    while len(found) < count:
        message = json.loads(receiver.packets(1)[0][1])
        if message["type"] == "pose":
            found.append(message["root"][1])
    return found


def test_a_source_that_wants_nothing_back_is_seen_in_the_sink() -> None:
    """The body's height is the sum of all that was heard: it rises while something is said."""
    with Receiver() as receiver:
        settings = dataclasses.replace(FAST, sinks=(f"json://127.0.0.1:{receiver.port}?rate=60",))
        with serving(settings=settings) as server, server.call(Hello(want=())) as caller:
            caller.speak(1, np.full(24_000, 0.5, np.float32))
            before = heights(receiver, 3)
            time.sleep(1.5)
            receiver.empty()
            after = heights(receiver, 3)
    assert after[-1] > before[0] + 0.01


def test_what_was_taken_back_is_not_shown_and_the_next_session_comes_on() -> None:
    with Receiver() as receiver:
        settings = dataclasses.replace(FAST, sinks=(f"json://127.0.0.1:{receiver.port}",))
        with serving(settings=settings) as server:
            with server.call(Hello()) as caller:
                caller.speak(1, np.full(240_000, 0.5, np.float32))
                caller.until(State, lambda told: told.state == "speaking")
                caller.say(Interrupt())
                caller.until(Flush)
                heights(receiver, 3)
            assert server.empties()
            with server.call(Hello()) as caller:
                caller.until(Motion, lambda motion: motion.at > 12_000)
                low = heights(receiver, 40)[-1]
    assert low < 0.01  # a new session has heard nothing


class Stuck:
    """A receiver that takes nothing and never comes back."""

    rate = 60.0
    let_go = threading.Event()

    def faces(self, curves: np.ndarray) -> np.ndarray:
        return curves

    def send(self, frame: object) -> None:
        self.let_go.wait(30)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("kind", ["stuck", "gone"])
def test_sinks_that_hang_or_are_gone_change_nothing(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with Receiver() as receiver:
        gone = f"vmc://127.0.0.1:{receiver.port}"
    if kind == "stuck":
        monkeypatch.setattr(sink_router, "make_sink", lambda *_: Stuck())
    settings = dataclasses.replace(FAST, sinks=(gone, gone))
    began = time.monotonic()
    with serving(settings=settings) as server, server.call(Hello()) as caller:
        caller.speak(1, np.full(48_000, 0.2, np.float32))
        motions: list[Any] = [caller.until(Motion) for _ in range(10)]
        assert [motion.at for motion in motions] == [6_400 * k for k in range(10)]
        assert server.manager.is_well
    assert time.monotonic() - began < 12
    Stuck.let_go.set()


def test_an_address_that_is_none_is_refused_at_once() -> None:
    with pytest.raises(EchoAvatarError, match="no known kind"):
        SinkRouter(["ftp://there"], Rig(names=("hips",), parents=(-1,), rest=((0.0, 0.0, 0.0),)))
