"""One WebSocket connection: hello, then messages in both directions until one side closes it."""

import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress

import anyio
import anyio.lowlevel
from starlette.websockets import WebSocket, WebSocketDisconnect

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.blobs import split_audio
from echoavatar.wire.codec import ProtocolError, decode_client, encode, negotiate, subprotocol
from echoavatar.wire.guard import check_origin
from echoavatar.wire.messages import (
    CLOSE_CODES,
    Action,
    Audio,
    ClientMessage,
    Encoding,
    End,
    Error,
    Hello,
    Interrupt,
    Manner,
    Music,
    Ping,
    Played,
    Pong,
    ServerMessage,
    Words,
)

from .clients import client_of
from .opus import choose
from .outbox import Outbox
from .session import ServerSession, answer
from .session_manager import SessionManager

_LOG = logging.getLogger(__name__)
STRIKES = 100  # errors that do not end the connection
SEND_S = 20.0  # time to send one frame
GOODBYES = (1000, 1001)  # close codes of clients that do not resume


class Connection:
    """One client's connection."""

    def __init__(self, websocket: WebSocket, manager: SessionManager) -> None:
        self._socket, self._manager = websocket, manager
        self._encoding: Encoding = "msgpack"
        self._outbox = Outbox()
        self._session: ServerSession | None = None
        self._client = client_of(websocket.scope)
        self._strikes = 0
        self._error: ProtocolError | None = None  # why the server closes the connection
        self._left: int | None = None  # the close code, if the client closed it

    async def run(self) -> None:
        """Serve the connection until it is closed."""
        manager, self._silence = self._manager, anyio.CancelScope()
        if not manager.admission.enter(self._silence, self._client):
            manager.metrics.refused.inc()
            await self._socket.close(1013)
            return
        try:
            await self._talk()
        finally:
            manager.admission.leave(self._silence)
            if self._session is not None:
                manager.leave(self._session, self._outbox, for_good=self._left in GOODBYES)
            # Tracebacks refer back to this connection, and the cycle lives until the garbage collector runs. So drop
            # everything large.
            self._session = self._error = None
            self._outbox.clear()

    async def _talk(self) -> None:
        agreed = negotiate(self._socket.scope.get("subprotocols", []))
        self._encoding = agreed[0] if agreed else "msgpack"
        await self._socket.accept(subprotocol(*agreed) if agreed else None)
        with self._silence:
            await self._run_guarded(self._enter)
        if self._session is not None:
            async with anyio.create_task_group() as tasks:
                for half in (self._send, self._receive):
                    tasks.start_soon(self._run_guarded, half, tasks.cancel_scope)
        elif self._silence.cancelled_caught:
            self._error = ProtocolError(
                "overloaded", "other clients need this connection; say hello at once", retry_after=5.0
            )
        if self._left is None:
            await self._goodbye()

    async def _run_guarded(self, half: Callable[[], Awaitable[None]], scope: anyio.CancelScope | None = None) -> None:
        """Run sending or receiving until it ends, record why, and end the other."""
        try:
            await half()
        except ProtocolError as error:
            self._error = self._error or error
        except WebSocketDisconnect as left:
            self._left = left.code
        except OSError:
            self._left = 1006
        except Exception:  # a fault of ours ends this connection only, with a message
            _LOG.exception("a connection failed")
            self._error = self._error or ProtocolError("internal", "the server made a mistake; connect again")
        if scope is not None:
            scope.cancel()

    async def _enter(self) -> None:
        check_origin(self._socket.headers, self._manager.settings.origins)
        message = await self._next(self._manager.settings.hello_seconds, "no hello came")
        if not isinstance(message, Hello):
            raise ProtocolError("bad_order", "the first message must be a hello")
        await self._manager.clients.pace("hellos", self._client)
        self._manager.clients.gate.check(message.token, self._socket.headers, self._client)
        self._outbox = Outbox(message.want, choose(message.sound))
        self._form = message.audio
        self._session = self._manager.enter(message, self._outbox)
        self._manager.admission.greet(self._silence)

    async def _send(self) -> None:
        while (message := await self._outbox.take()) is not None:
            try:
                with anyio.fail_after(SEND_S):
                    await self._write(message)
            except TimeoutError as error:
                raise ProtocolError("too_slow", "the connection does not take what is sent") from error
        if self._outbox.is_hopeless:
            raise ProtocolError("too_slow", "the connection cannot carry the sound; resume when it can")

    async def _receive(self) -> None:
        patience = 2 * self._manager.settings.ping_seconds
        while True:
            message = await self._next(patience, "nothing came for too long; send pings")
            await self._pace(message)
            if self._session is not None:
                self._manager.confirm(self._session, self._outbox)
            try:
                await self._handle(message)
            except ProtocolError as error:
                if error.fatal:
                    raise
                self._report(error)

    async def _pace(self, message: ClientMessage) -> None:
        """Wait if the client sends faster than it may."""
        clients = self._manager.clients
        if isinstance(message, Audio | End | Words):
            await clients.pace("sounds", str(id(self)))
        elif isinstance(message, Played | Ping):
            await clients.pace("reports", self._client)
        else:
            await clients.pace("commands", self._client)

    async def _handle(self, message: ClientMessage) -> None:
        session = self._session
        assert session is not None
        match message:
            case Audio() | End() | Words() if session.source is not self._outbox:
                raise ProtocolError("bad_order", "viewers send no speech; say hello as a source")
            case Audio():
                await self._hear(session, message)
            case End():
                session.finish(message)
            case Words():
                session.add_words(message)
            case Played():
                session.played(message, self._outbox)
            case Interrupt():
                self._manager.metrics.interrupts.inc()
                session.interrupt(message)
            case Action():
                session.act(message.name, intensity=message.intensity, hold_s=message.hold, id=message.id)
            case Manner():
                session.set_manner(message.liveliness, message.handedness)
            case Music(op="stop"):
                session.stop_music(id=message.id)
            case Music():
                await self._play(session, message)
            case Ping():
                self._outbox.put(Pong(nonce=message.nonce, at=session.end))
            case Hello():
                raise ProtocolError("bad_order", "hello was said already")

    async def _hear(self, session: ServerSession, message: Audio) -> None:
        """Take sound. The user's is analysed on the event loop, so other connections get a turn after each second."""
        for part in split_audio(message, self._form) if message.speaker == "user" else (message,):
            session.hear(part)
            await anyio.lowlevel.checkpoint()

    async def _play(self, session: ServerSession, message: Music) -> None:
        tracks, title = self._manager.tracks, message.title
        try:
            title = tracks.find(title)
            session.play(title, await self._manager.load_track(title), id=message.id)
        except EchoAvatarError as error:
            reason = str(error)
            self._outbox.put(answer(message.id, title, "rejected", session.end, reason=reason, choices=tracks.titles))

    async def _next(self, seconds: float, what: str) -> ClientMessage:
        try:
            with anyio.fail_after(seconds):
                frame = await self._socket.receive()
        except TimeoutError as error:
            raise ProtocolError("timeout", f"{what} within {seconds:g} s") from error
        if frame["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(frame.get("code") or 1005)
        content = frame.get("bytes")
        message = decode_client(frame["text"] if content is None else content, self._encoding)
        self._manager.metrics.messages.labels("in", type(message).__struct_config__.tag).inc()
        return message

    async def _write(self, message: ServerMessage) -> None:
        try:
            content = encode(message, self._encoding)
        except (ValueError, TypeError):  # text that cannot be encoded; other messages still arrive
            _LOG.exception("a message of type %s cannot be sent and is left out", type(message).__name__)
            return
        self._manager.metrics.messages.labels("out", type(message).__struct_config__.tag).inc()
        if self._encoding == "json":
            await self._socket.send_text(content.decode())
        else:
            await self._socket.send_bytes(content)

    def _report(self, error: ProtocolError) -> None:
        self._strikes += 1
        if self._strikes > STRIKES:
            raise ProtocolError(error.code, f"{STRIKES} errors were enough; the last: {error}") from error
        self._manager.metrics.errors.labels(error.code).inc()
        self._outbox.warn(error)

    async def _goodbye(self) -> None:
        """Close the connection, after an error message if none was sent yet."""
        error = self._error or self._outbox.error
        with anyio.move_on_after(2), suppress(WebSocketDisconnect, OSError, RuntimeError):
            if error is None:
                await self._socket.close(1000)
                return
            self._manager.metrics.errors.labels(error.code).inc()
            if error is not self._outbox.error:
                told, seconds = str(error), error.retry_after
                await self._write(
                    Error(code=error.code, message=told, fatal=True, retry_after=seconds, place=error.place)
                )
            await self._socket.close(CLOSE_CODES[error.code], str(error).encode()[:120].decode(errors="ignore"))
