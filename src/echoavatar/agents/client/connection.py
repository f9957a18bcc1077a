"""A client session: it says hello, sends speech, receives motion, and reconnects when the connection breaks."""

import asyncio
import itertools
import logging
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any
from urllib.parse import urlunsplit

import msgspec
import numpy as np
from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as connect_websocket
from websockets.exceptions import ConcurrencyError, ConnectionClosed, WebSocketException

from echoavatar import outgoing
from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.wire.blobs import pack_audio
from echoavatar.wire.codec import ProtocolError, decode_server, encode, subprotocol
from echoavatar.wire.messages import (
    CLOSE_CODES,
    MAX_MESSAGE_BYTES,
    Action,
    AudioFormat,
    BodyOptions,
    ClientMessage,
    Error,
    Flush,
    Hello,
    Interrupt,
    Manner,
    Music,
    Ping,
    Played,
    Ready,
    Role,
    ServerMessage,
    Sound,
    Word,
    Words,
)

from .utterances import UtteranceQueue

TIMEOUT_S = 10.0
CLOSE_S = 2.0  # for the server's farewell
RECONNECT_ATTEMPTS = 6  # the pauses between attempts grow to one second
STEADY_S = 5.0  # a connection that breaks sooner is not reopened at once
LEAST_PING_S = 0.1  # shortest time between pings, even if the server asks for less
_RECONNECT_CODES = (1006, 1011, 1012, CLOSE_CODES["too_slow"])  # close codes after which reconnecting makes sense


class ConnectionLostError(EchoAvatarError):
    """No server answers, or the connection to it was lost for good."""


def quiet_logger() -> logging.Logger:
    """A logger that never shows a request; the library would log headers and messages, with their keys, at DEBUG."""
    logger = logging.getLogger("echoavatar.agents.websocket")
    logger.setLevel(logging.ERROR)
    return logger


class _OneOrigin(connect_websocket):
    def process_redirect(self, exc: Exception) -> Exception:
        """Raise the redirect: the library would send keys and tokens to the other host."""
        return exc


async def open_websocket(url: str, **options: Any) -> ClientConnection:
    """Connect a WebSocket: through the proxy that `outgoing.proxy_for` names, to this origin only, and logging nothing.

    `options` are those of the websockets library.

    Raises:
        DependencyError: the proxy speaks SOCKS, and python-socks is missing.
        OSError, TimeoutError, WebSocketException: the library cannot connect.
    """
    proxy = await asyncio.to_thread(outgoing.proxy_for, url)
    try:
        return await _OneOrigin(url, proxy=proxy, compression=None, logger=quiet_logger(), **options)
    except ImportError as error:
        raise DependencyError(
            f"{outgoing.redacted(url)} is behind a SOCKS proxy: pip install 'python-socks[asyncio]', "
            f"or {outgoing.HTTP_PROXIES_ONLY}"
        ) from error


class Avatar:
    """One session as its source; open it with `connect`. Iterate over it to receive messages: they must be read.

    While you iterate, a broken connection is reopened and another `Ready` arrives. If that one is not `resumed`, the
    old session was lost: a new one, perhaps at another server, continues with the speech that was not played yet, and
    its clock starts at `ready.at`.
    """

    def __init__(self, url: str, hello: Hello) -> None:
        self.ready: Ready
        self.epoch = 0
        self._url, self._hello = url, hello
        self._socket: ClientConnection | None = None
        self._closing: asyncio.Task[None] | None = None
        self._is_over = False  # its user closed it
        self._utterances = UtteranceQueue(hello.audio)
        self._ids = (f"py-{number}" for number in itertools.count(1))
        self._opened_at = 0.0  # by the loop's clock
        self._short_lived = 0  # connections in a row that broke soon after they were opened

    @property
    def received(self) -> int:
        """The clock up to which sound has been received."""
        return self._utterances.received

    # ---- sending

    async def speak(self, samples: np.ndarray, *, end: bool = True, words: Iterable[Sequence[Any]] = ()) -> int:
        """Say samples: mono, at the rate given to `connect`, floats in -1..1 or int16. Returns the utterance's number.

        With `end=False` the next call continues the same utterance. `words` are as in the method `words`. Raises
        EchoAvatarError if the samples have another shape or type, or are not finite.
        """
        seg = self._utterances.add(_pcm(samples), end=end)
        if words:
            await self.words(words, seg=seg)
        await self._send_due()
        return seg

    async def words(self, words: Iterable[Sequence[Any]], *, seg: int = 0) -> None:
        """Send words of utterance `seg` (0: the next that `speak` begins): (text, start) or (text, start, end).

        Times are seconds from its first sample, in order. Some words get a gesture that shows what they mean.
        """
        told = tuple(Word(**dict(zip(("text", "start", "end"), word, strict=False))) for word in words)
        await self.send(Words(seg=seg or self._utterances.seg + 1, words=told))

    async def interrupt(self, heard: int | None = None) -> None:
        """Stop speaking. `heard`: the clock of the first sample that was not heard (None: the server's estimate)."""
        self._utterances.interrupt()
        await self.send(Interrupt(heard=heard, seg=self._utterances.seg))

    async def act(self, name: str, *, intensity: float = 1.0, hold: float | None = None) -> str:
        """Request an action; its id comes back in `ActionStatus` messages."""
        request = Action(id=next(self._ids), name=name, intensity=intensity, hold=hold)
        await self.send(request)
        return request.id

    async def set_manner(self, *, liveliness: float | None = None, handedness: float | None = None) -> None:
        """Change how the speaker gestures, 0 to 1 each; None leaves it as it is."""
        await self.send(Manner(liveliness=liveliness, handedness=handedness))

    async def play_music(self, title: str = "") -> str:
        """Play one of `ready.tracks` (empty: the first); its id comes back in `ActionStatus` messages."""
        request = Music(id=next(self._ids), op="play", title=title)
        await self.send(request)
        return request.id

    async def stop_music(self) -> None:
        """Fade the music out."""
        await self.send(Music(id=next(self._ids), op="stop"))

    async def played(self, at: int) -> None:
        """Report the clock that playback has reached; without reports the server goes by the wall clock."""
        await self.send(Played(at=at, epoch=self.epoch))

    async def send(self, message: ClientMessage) -> None:
        """Send any message. While the connection is broken messages are lost; sound is sent again later."""
        if self._socket is not None:
            with suppress(ConnectionClosed):
                await self._socket.send(encode(message))

    # ---- receiving

    async def __aiter__(self) -> AsyncIterator[ServerMessage]:
        while True:
            try:
                message = await self.receive()
            except ConnectionClosed as closed:
                if self._is_over or not await self._reconnect(closed):
                    return
                yield self.ready
                continue
            await self._send_due()
            if message is not None:
                yield message

    async def receive(self) -> ServerMessage | None:
        """Receive the next message; None for a type that this version does not know.

        Raises:
            ConnectionClosed: the connection is broken; iterating over the session reconnects by itself.
            ProtocolError: the server refused the session, or sent a message that is not valid.
        """
        assert self._socket is not None
        try:
            data = await self._socket.recv(decode=False)
        except ConcurrencyError:
            if self._closing is None:
                raise
            await asyncio.shield(self._closing)  # `_hang_up` reads what is left
            data = await self._socket.recv(decode=False)
        message = decode_server(data)
        match message:
            case Error(fatal=True) if CLOSE_CODES[message.code] not in _RECONNECT_CODES:
                raise ProtocolError(message.code, message.message, retry_after=message.retry_after)
            case Sound():
                self._utterances.hear(message)
            case Flush():
                self.epoch = message.epoch
                self._utterances.flush(message)
        return message

    # ---- connection

    async def open(self) -> None:
        """Connect and say hello; no connection is left open if that fails.

        Raises:
            ConnectionLostError: no server answers there.
            ProtocolError: the server refused the session.
        """
        try:
            self._socket = await open_websocket(
                self._url,
                subprotocols=[subprotocol("msgpack")],
                max_size=MAX_MESSAGE_BYTES,
                open_timeout=TIMEOUT_S,
                close_timeout=CLOSE_S,
            )
            await self._socket.send(encode(self._hello))
            ready = await asyncio.wait_for(self.receive(), TIMEOUT_S)
            if not isinstance(ready, Ready):
                raise ProtocolError("bad_order", "the server's first message was not `ready`")
        except BaseException as error:
            await self._hang_up()
            if isinstance(error, OSError | TimeoutError | WebSocketException):
                raise ConnectionLostError(
                    f"no server answers at {outgoing.redacted(self._url)} ({type(error).__name__}); "
                    "start one with `echoavatar serve`"
                ) from None  # its text may hold a password of the address or of a proxy
            raise
        self.ready, self.epoch = ready, ready.epoch
        self._opened_at = asyncio.get_running_loop().time()

    async def close(self) -> None:
        """Close the connection; the session ends, and whoever iterates over it opens no other."""
        self._is_over = True
        await self._hang_up()

    async def _hang_up(self) -> None:
        if self._socket is not None:
            self._closing = asyncio.create_task(self._socket.close())
            with suppress(ConnectionClosed, ConcurrencyError):  # another reader reads the rest
                while True:  # the library stops reading before unread messages; the farewell is behind them
                    await self._socket.recv(decode=False)
            await self._closing

    async def keep_alive(self) -> None:
        """Ping as often as the server asks for, until cancelled."""
        while True:
            await asyncio.sleep(max(LEAST_PING_S, self.ready.limits.ping_seconds / 2))
            await self.send(Ping())

    async def _reconnect(self, closed: ConnectionClosed) -> bool:
        """Reconnect and resume the session; false when the server closed it in an orderly way, or its user did."""
        code = closed.rcvd.code if closed.rcvd else 1006
        if code not in _RECONNECT_CODES:
            return False
        has_lasted = asyncio.get_running_loop().time() - self._opened_at > STEADY_S
        self._short_lived = 0 if has_lasted else self._short_lived + 1
        if self._short_lived > 1:
            await asyncio.sleep(_pause(self._short_lived))
        changes: dict[str, Any] = {"resume": self.ready.resume, "played": self.received, "epoch": self.epoch}
        for attempt in range(RECONNECT_ATTEMPTS):
            self._hello = msgspec.structs.replace(self._hello, **changes)
            try:
                await self.open()
                break
            except ConnectionLostError:
                if attempt == RECONNECT_ATTEMPTS - 1:
                    raise
            except ProtocolError as error:
                if error.code == "unknown_session":
                    changes = {"resume": "", "played": 0, "epoch": None}
                elif error.code != "overloaded" or attempt == RECONNECT_ATTEMPTS - 1:
                    raise
            await asyncio.sleep(_pause(attempt))
            if self._is_over:
                return False
        if self._is_over:
            await self._hang_up()
            return False
        if self.ready.resumed:
            self._utterances.go_on(self.ready)
        else:
            self._utterances.begin_anew(self.ready)
        await self._send_due()
        return True

    async def _send_due(self) -> None:
        for message in self._utterances.due():
            await self.send(message)


@asynccontextmanager
async def connect(
    url: str, *, token: str = "", rate: int = 24_000, seed: int = 0, body: BodyOptions | None = None, watch: str = ""
) -> AsyncIterator[Avatar]:
    """Open a session at a server such as `http://127.0.0.1:8765`.

    `body` keeps the avatar near its place, such as `BodyOptions(leash_m=0.5)` before a camera that does not follow.
    `watch` is the public name of a running session to watch instead.

    Raises:
        ConnectionLostError: no server answers there.
        ProtocolError: the server refused the session: wrong token, or no free seat.
    """
    role: Role = "viewer" if watch else "source"
    form = AudioFormat(rate=rate)
    hello = Hello(token=token, audio=form, seed=seed, body=body or BodyOptions(), role=role, session=watch)
    avatar = Avatar(stream_url(url), hello)
    await avatar.open()
    alive = asyncio.create_task(avatar.keep_alive())
    try:
        yield avatar
    finally:
        alive.cancel()
        await avatar.close()


def stream_url(url: str) -> str:
    """The WebSocket URL of a server's address, which may be given with http, with ws, or without a scheme.

    Raises:
        EchoAvatarError: the address is not valid.
    """
    schemes = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}
    parts = outgoing.address_parts(url if "://" in url else f"http://{url}", *schemes)
    if parts is None:
        raise EchoAvatarError(
            f"{outgoing.redacted(url)!r} is not a server address; give one such as http://127.0.0.1:8765"
        )
    path = parts.path if parts.path.strip("/") else "/v1/stream"
    return urlunsplit((schemes[parts.scheme], parts.netloc, path, "", ""))


def _pause(attempt: int) -> float:
    """Seconds before another attempt to connect."""
    return min(1.0, 0.1 * 2.0 ** min(attempt, 10))


def _pcm(samples: np.ndarray) -> bytes:
    if samples.ndim != 1:
        raise EchoAvatarError(f"samples of shape {samples.shape}; give one channel, (samples,)")
    if samples.dtype.kind == "f":
        if not np.isfinite(samples).all():
            raise EchoAvatarError("the samples are not all finite; replace NaN and infinity by 0")
        return pack_audio(samples)
    if samples.dtype == np.int16:
        return bytes(samples.astype("<i2").data)
    raise EchoAvatarError(f"samples of type {samples.dtype}; give floats in -1..1 or int16")
