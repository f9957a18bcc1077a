"""A server with a minimal pipeline on a free port, and a client that sends what a test asks for."""

import contextlib
import json
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tests.engine.fakes import FakePipeline, Heard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from echoavatar.engine import Engine
from echoavatar.engine.pipeline.actions import Action, ActionLibrary
from echoavatar.motion import gaze, homecoming, idle_motion
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.server import ServerSettings, create_app
from echoavatar.server.run import Server
from echoavatar.timing import CHUNK, ChunkSize
from echoavatar.wire.blobs import pack_audio
from echoavatar.wire.codec import decode_server, encode, subprotocol
from echoavatar.wire.messages import Audio, ClientMessage, Error, Hello, Ready, ServerMessage

FAST = ServerSettings(resume_seconds=1.0, drain_seconds=1.0, hello_seconds=2.0)


class Body(FakePipeline):
    """The hips' height is the sum of all that was heard, in units of ten micrometres."""

    skeleton = HUMANOID
    actions = ActionLibrary({name: Action(name, (0,) * 8, (1, 2)) for name in ("wave", "bow")})

    def __init__(self, seconds: float = 0.0, chunk: ChunkSize = CHUNK) -> None:
        self.seconds, self.chunk = seconds, chunk

    def step(self, audio: np.ndarray, state: Heard, active: np.ndarray, **told: object) -> Any:
        time.sleep(self.seconds)
        chunks = super().step(audio, state, active)
        return [chunk._replace(root=(chunk.root * 1e-5).astype(np.float32)) for chunk in chunks]


@contextlib.contextmanager
def serving(
    *,
    seats: int = 4,
    settings: ServerSettings = FAST,
    step_s: float = 0.0,
    pipeline: Any = None,
    workers: int | None = None,
    tls: tuple[Path, Path] | None = None,
) -> Iterator["RunningServer"]:
    for part in (homecoming, idle_motion, gaze):  # as `open_engine` does: compiling holds up the server's loop
        part.warm_up(HUMANOID)
    engine = Engine(pipeline or Body(step_s), seats=seats, workers=workers)
    engine._capacity.note = lambda *_: None  # who is let in must not depend on how busy this machine is
    app = create_app(engine, settings)
    begun = threading.Event()
    files = {"certificate": str(tls[0]), "key": str(tls[1])} if tls else {}
    server = Server(app, port=0, on_ready=lambda _: begun.set(), **files)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    assert begun.wait(10)
    try:
        yield RunningServer(server.address.partition("://")[2], app.state.manager, server, thread)
    finally:
        server.should_exit = True
        thread.join(10)
        assert not thread.is_alive()


class RunningServer:
    def __init__(self, address: str, manager: Any, server: Server, thread: threading.Thread) -> None:
        self.address, self.manager, self.uvicorn, self.thread = address, manager, server, thread

    def empties(self, seconds: float = 15.0) -> bool:
        """Wait until nobody is there."""
        end = time.monotonic() + seconds
        while self.manager.sessions and time.monotonic() < end:
            time.sleep(0.05)
        return not self.manager.sessions

    def http(self, path: str, body: bytes | None = None, **headers: str) -> tuple[int, Any]:
        """Status and content of an answer, decoded where it is JSON; `_` in a header's name stands for `-`."""
        given = {"content-type": "application/json"} | {key.replace("_", "-"): value for key, value in headers.items()}
        request = urllib.request.Request(f"http://{self.address}{path}", body, given)
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                status, text = answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            with error:
                status, text = error.code, error.read().decode()
        try:
            return status, json.loads(text)
        except ValueError:
            return status, text

    def call(self, hello: Hello | None = None, **options: Any) -> "Caller":
        way = connect(
            f"ws://{self.address}/v1/stream",
            subprotocols=[subprotocol("msgpack")],  # type: ignore[list-item]
            compression=None,
            close_timeout=1.0,  # what the test did not read may keep the farewell back
            **options,
        )
        return Caller(way, hello)


class Caller:
    """Says what it likes, and remembers what it was told."""

    def __init__(self, way: Any, hello: Hello | None) -> None:
        self._way = way
        self.line: ClientConnection = way.__enter__()
        self.heard: list[ServerMessage] = []
        if hello is not None:
            self.say(hello)
            self.ready = self.until(Ready)

    def say(self, message: ClientMessage) -> None:
        self.line.send(encode(message))

    def next(self, seconds: float = 15.0) -> ServerMessage:
        message = decode_server(self.line.recv(timeout=seconds))
        assert message is not None
        self.heard.append(message)
        return message

    def until(self, kind: Any, test: Callable[[Any], bool] = lambda _: True, seconds: float = 15.0) -> Any:
        end = time.monotonic() + seconds
        while True:
            message = self.next(max(0.01, end - time.monotonic()))
            if isinstance(message, kind) and test(message):
                return message

    def closing(self, seconds: float = 10.0) -> tuple[int, Error | None]:
        """Read to the end: the close code, and the fatal error before it."""
        while True:
            try:
                self.next(seconds)
            except ConnectionClosed as closed:
                fatal = [told for told in self.heard if isinstance(told, Error) and told.fatal]
                return closed.rcvd.code if closed.rcvd else 1006, fatal[-1] if fatal else None

    def speak(self, seg: int, samples: np.ndarray, start: int = 0) -> None:
        self.say(Audio(seg=seg, start=start, pcm=pack_audio(samples)))

    def __enter__(self) -> "Caller":
        return self

    def __exit__(self, *reason: object) -> None:
        self._way.__exit__(*reason)
