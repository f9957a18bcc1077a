"""The process: uvicorn with our limits, a shutdown that lets speech end, and logs as JSON (`serve --log json`).

`GuardedWebSocket` bounds what the application never sees: requests that cannot be read, control frames and
fragments.
"""

import asyncio
import gc
import json
import logging
import socket
import time
from collections.abc import Callable
from typing import Any, Literal

from starlette.applications import Starlette
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.codec import TOO_LARGE, encode, negotiate
from echoavatar.wire.messages import CLOSE_CODES, MAX_MESSAGE_BYTES, Error
from echoavatar.wire.rates import Limiter, Rate
from echoavatar.wire.sockets import CONNECTIONS, WebServer

from .session_manager import SessionManager
from .settings import ServerSettings

HELLO_BYTES = 1 << 20  # most bytes from a client that was not answered yet
REFUSED_S = 10.0  # longest time in which the rest of a refused message is read and thrown away
QUIET_S = 0.5  # a refused connection that sends nothing for so long is closed
CLOSE_S = 3.0  # for a client's answer to our close
CONTROL_FRAMES_A_SECOND = 10.0  # pings and pongs of one WebSocket
CONTROL_FRAMES_AT_ONCE = 50.0
MAX_UNREAD_BYTES = 1 << 20  # pongs that a client does not read
MAX_FRAGMENTS = 4_096  # of one message; empty fragments escape the limit on its size


class GuardedWebSocket(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket within these bounds."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.close_timeout = CLOSE_S
        self._control_frames = Limiter()
        self._unanswered, self._is_answered, self._refused_at = 0, False, 0.0

    def data_received(self, data: bytes) -> None:
        """Bytes came, the whole request first; one that the websockets library cannot read is refused."""
        if self._refused_at:
            self._close_when_quiet()
            return
        self._unanswered += len(data)
        if self._unanswered > HELLO_BYTES and not self._is_answered:
            self._refuse("send `hello` first, and the sound after `ready`")
            return
        super().data_received(data)
        if not self.handshake_initiated:  # the library raises nothing, and would wait for ever
            self.transport.write(b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
            self.close_sent = True
            self.transport.close()

    async def send(self, message: Any) -> None:
        """Send, unless the client is gone: each write to a lost socket would be logged."""
        await self.writable.wait()
        if message["type"] != "websocket.send" or not self.transport.is_closing():
            await super().send(message)
        if message["type"] == "websocket.send" and not self._is_answered:
            self._is_answered = True
            self._read_on()

    async def receive(self) -> Any:
        """The next message. Nothing more is read before the first one is answered."""
        message = await super().receive()
        if message["type"] == "websocket.receive" and not self._is_answered and not self._refused_at:
            self.read_paused = True
            self.transport.pause_reading()
        return message

    def handle_parser_exception(self) -> None:
        """A message breaks WebSocket's rules or is too long: the client is told which, before the close."""
        assert self.conn.close_sent is not None
        if self.conn.close_sent.code == CLOSE_CODES["too_large"]:
            self._refuse(TOO_LARGE)
        else:
            super().handle_parser_exception()

    def _refuse(self, why: str) -> None:
        """Send an error and the close, and read on for a while: a socket closed with bytes unread loses both."""
        if not self.handshake_complete:
            self.transport.abort()
            return
        code, agreed = CLOSE_CODES["too_large"], negotiate(self.scope["subprotocols"])
        encoding = agreed[0] if agreed else "msgpack"
        error = encode(Error(code="too_large", message=why, fatal=True, retry_after=0.0), encoding)
        frame = Frame(Opcode.TEXT if encoding == "json" else Opcode.BINARY, error)
        if self.conn.close_sent is None:
            self.conn.send_close(code, why)
        self.transport.write(frame.serialize(mask=False) + b"".join(self.conn.data_to_send()))
        self.queue.put_nowait({"type": "websocket.disconnect", "code": code, "reason": why})
        self.close_sent, self._refused_at = True, self.loop.time()
        self._read_on()
        self._close_when_quiet()

    def _close_when_quiet(self) -> None:
        if self.close_timer is not None:
            self.close_timer.cancel()
        at = min(self.loop.time() + QUIET_S, self._refused_at + REFUSED_S)
        self.close_timer = self.loop.call_at(at, self.transport.close)

    def _read_on(self) -> None:
        if self.read_paused and (self.queue.empty() or self._refused_at):
            self.read_paused = False
            self.transport.resume_reading()

    def handle_ping(self) -> None:
        """Answer a ping, unless the client sends too many or does not read the answers."""
        if self._is_allowed():
            super().handle_ping()

    def handle_pong(self, event: Frame) -> None:
        """Take note of a pong, unless the client sends too many."""
        if self._is_allowed():
            super().handle_pong(event)

    def handle_cont(self, event: Frame) -> None:
        """A fragment of a message."""
        if len(self.frames) < MAX_FRAGMENTS:
            super().handle_cont(event)
        else:
            self.transport.abort()

    def _is_allowed(self) -> bool:
        is_often = self._control_frames.wait("", Rate(CONTROL_FRAMES_AT_ONCE, 60 * CONTROL_FRAMES_A_SECOND)) > 0
        if not is_often and self.transport.get_write_buffer_size() < MAX_UNREAD_BYTES:
            return True
        if not self.transport.is_closing():
            self.transport.abort()
        return False


class JsonFormatter(logging.Formatter):
    """One object a line: time in UTC, level, logger, message, and where there are any, session and traceback."""

    converter = staticmethod(time.gmtime)

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record; `extra={"session": name}` names a session."""
        line = {
            "time": f"{self.formatTime(record, '%Y-%m-%dT%H:%M:%S')}.{record.msecs:03.0f}Z",
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if isinstance(session := getattr(record, "session", None), str):
            line["session"] = session
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json.dumps(line)


def log_json() -> None:
    """Log in JSON from now on."""
    for handler in logging.getLogger().handlers:
        handler.setFormatter(JsonFormatter())


class Server(WebServer):
    """Drains the sessions before the connections are closed; a second signal ends it at once."""

    def __init__(self, app: Starlette, *, host: str = "127.0.0.1", lifespan: Literal["on", "off"] = "on", **more: Any):
        settings: ServerSettings = app.state.manager.settings
        super().__init__(
            app,
            host=host,
            names=None if settings.token else settings.origins,
            connections=settings.connections + CONNECTIONS,
            proxies=settings.proxies,
            lifespan=lifespan,
            ws=GuardedWebSocket,
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_per_message_deflate=False,
            ws_ping_interval=None,
            **more,
        )
        self._manager: SessionManager = app.state.manager

    async def on_tick(self, counter: int) -> bool:
        """Whether to stop: also if the engine failed for good, so that a supervisor can restart the process."""
        return await super().on_tick(counter) or self._manager.failure is not None

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Drain the sessions, then close the connections."""
        drain = asyncio.ensure_future(self._manager.drain())
        while not drain.done() and not self.force_exit:
            await asyncio.wait([drain], timeout=0.1)
        drain.cancel()
        await super().shutdown(sockets)


def serve(
    app: Starlette,
    *,
    host: str = "127.0.0.1",
    port: int = 8765,
    on_ready: Callable[[str], None] | None = None,
    ssl_certfile: str | None = None,
    ssl_keyfile: str | None = None,
) -> None:
    """Serve until SIGINT or SIGTERM; port 0 takes any free one. `on_ready` receives the address.

    Raises EchoAvatarError: as `WebServer`; or the engine failed again and again.
    """
    server = Server(app, host=host, port=port, on_ready=on_ready, certificate=ssl_certfile, key=ssl_keyfile)
    gc.collect()
    gc.set_threshold(700, 10, 10)  # Python's own: the command line raised it for the start
    gc.freeze()  # without this, Python lets 100,000 objects of garbage gather before it looks for cycles
    server.run()
    if (failure := app.state.manager.failure) is not None:
        raise EchoAvatarError(f"the engine failed again and again, at last with: {failure}")
