"""The line to a server: says hello, speaks, listens, and comes back after a break."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any, Protocol
from urllib.parse import urlsplit, urlunsplit

import msgspec
import numpy as np
from jaxtyping import Shaped
from websockets.asyncio.client import connect as connect_websocket
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from ..errors import EchoAvatarError
from ..wire import (
    CLOSE_CODES,
    MAX_MESSAGE_BYTES,
    Action,
    AudioFormat,
    ClientMessage,
    Error,
    Flush,
    Hello,
    Interrupt,
    Music,
    Ping,
    Played,
    ProtocolError,
    Ready,
    ServerMessage,
    Sound,
    decode_server,
    encode,
    subprotocol,
)
from .spoken import Spoken

PATIENCE_S = 10.0
TRIES = 6  # to come back, a second apart at most
_LOST = (1006, 1011, 1012, CLOSE_CODES["too_slow"])  # closes after which coming back makes sense


class ConnectionLostError(EchoAvatarError):
    """There is no server, or no more."""


class Line(Protocol):
    """What messages go over: a WebSocket, or something like it."""

    async def send(self, message: bytes) -> None:
        """One frame; raises `ConnectionClosed` once the line is broken."""

    async def recv(self, *, decode: bool | None = None) -> bytes | str:
        """The next frame; raises `ConnectionClosed` once the line is broken."""

    async def close(self) -> None:
        """End it in good order."""


Dial = Callable[[], Awaitable[Line]]


class Avatar:
    """One session, as its source; open it with `connect`. Iterate to receive messages; they must be read.

    A broken line is mended while iterating: another `Ready` comes. Where it is not `resumed`, the session was lost and
    a new one, perhaps at another server, goes on with what was not played: its clock begins at `ready.at` again.
    """

    def __init__(self, url: str, hello: Hello, dial: Dial | None = None) -> None:
        """`dial` reaches the server in another way than by a WebSocket to `url`."""
        self.ready: Ready
        self.epoch = 0
        self._url, self._hello = url, hello
        self._dial = dial or self._dial_websocket
        self._line: Line | None = None
        self._spoken = Spoken(hello.audio)
        self._requests = 0

    @property
    def received(self) -> int:
        """Clock up to which sound came."""
        return self._spoken.received

    # ---- saying

    async def speak(self, samples: Shaped[np.ndarray, " s"], *, end: bool = True) -> int:
        """Say samples (mono, at the rate given to `connect`; floats in -1..1 or int16); returns the utterance's number.

        With `end=False` the next call continues the same utterance.
        """
        seg = self._spoken.add(_pcm(samples), end=end)
        await self._pump()
        return seg

    async def interrupt(self, heard: int | None = None) -> None:
        """Stop; `heard` is the clock of the first sample that was not heard."""
        self._spoken.interrupt()
        await self.send(Interrupt(heard=heard, seg=self._spoken.seg))

    async def act(self, name: str, *, intensity: float = 1.0, hold: float | None = None) -> str:
        """Ask for an action; its id comes back in `ActionStatus` messages."""
        await self.send(Action(id=self._id(), name=name, intensity=intensity, hold=hold))
        return f"py-{self._requests}"

    async def play_music(self, title: str = "") -> str:
        """Play one of `ready.tracks`."""
        await self.send(Music(id=self._id(), op="play", title=title))
        return f"py-{self._requests}"

    async def stop_music(self) -> None:
        """Fade it out."""
        await self.send(Music(id=self._id(), op="stop"))

    async def played(self, at: int) -> None:
        """Tell how far playback is; without it, the server goes by the wall clock."""
        await self.send(Played(at=at, epoch=self.epoch))

    async def send(self, message: ClientMessage) -> None:
        """Say anything; while the line is broken it is lost, but for sound."""
        if self._line is not None:
            with suppress(ConnectionClosed):
                await self._line.send(encode(message))

    # ---- listening

    def __aiter__(self) -> AsyncIterator[ServerMessage]:
        return self._messages()

    async def _messages(self) -> AsyncIterator[ServerMessage]:
        while True:
            try:
                message = await self.receive()
            except ConnectionClosed as closed:
                if not await self._come_back(closed):
                    return
                yield self.ready
                continue
            await self._pump()
            if message is not None:
                yield message

    async def receive(self) -> ServerMessage | None:
        """The next message; None for one that this version does not know.

        Raises:
            ConnectionClosed: the line is broken; iterating comes back by itself.
            ProtocolError: the server refused us, or speaks nonsense.
        """
        assert self._line is not None
        message = decode_server(await self._line.recv(decode=False))
        match message:
            case Error(fatal=True) if CLOSE_CODES[message.code] not in _LOST:
                raise ProtocolError(message.code, message.message, retry_after=message.retry_after)
            case Sound():
                self._spoken.hear(message)
            case Flush():
                self.epoch = message.epoch
                self._spoken.flush(message)
        return message

    # ---- the line

    async def open(self) -> None:
        """Say hello; leaves no connection behind where that fails.

        Raises:
            ConnectionLostError: nobody answers there.
            ProtocolError: the server refused us.
        """
        try:
            await self._greet()
        except BaseException:
            await self.close()
            raise

    async def _greet(self) -> None:
        try:
            self._line = await self._dial()
            await self._line.send(encode(self._hello))
            ready = await asyncio.wait_for(self.receive(), PATIENCE_S)
        except (OSError, TimeoutError, InvalidHandshake, ConnectionClosed) as error:
            raise ConnectionLostError(
                f"no server answers at {self._url} ({type(error).__name__}); start one with `echoavatar serve`"
            ) from error
        if not isinstance(ready, Ready):
            raise ProtocolError("bad_order", "the server did not say ready first")
        self.ready, self.epoch = ready, ready.epoch

    async def _dial_websocket(self) -> Line:
        return await connect_websocket(
            self._url,
            subprotocols=[subprotocol("msgpack")],  # type: ignore[list-item]
            compression=None,
            max_size=MAX_MESSAGE_BYTES,
            open_timeout=PATIENCE_S,
        )

    async def close(self) -> None:
        """Say goodbye; the session ends."""
        if self._line is not None:
            await self._line.close()

    async def keep_alive(self) -> None:
        """Ping as often as the server wants it, until cancelled."""
        while True:
            await asyncio.sleep(self.ready.limits.ping_seconds / 2)
            await self.send(Ping())

    async def _come_back(self, closed: ConnectionClosed) -> bool:
        """Resume the session; false when the server ended it in good order."""
        code = closed.rcvd.code if closed.rcvd else 1006
        if code not in _LOST:
            return False
        changes: dict[str, Any] = {"resume": self.ready.resume, "played": self.received}
        for attempt in range(TRIES):
            self._hello = _with(self._hello, **changes)
            try:
                await self.open()
                break
            except ConnectionLostError:
                if attempt == TRIES - 1:
                    raise
            except ProtocolError as error:
                if error.code == "unknown_session":
                    changes = {"resume": "", "played": 0}
                elif error.code != "overloaded" or attempt == TRIES - 1:
                    raise
            await asyncio.sleep(min(1.0, 0.1 * 2**attempt))
        if self.ready.resumed:
            self._spoken.go_on(self.ready)
        else:
            self._spoken.begin_anew(self.ready)
        await self._pump()
        return True

    async def _pump(self) -> None:
        for message in self._spoken.due():
            await self.send(message)

    def _id(self) -> str:
        self._requests += 1
        return f"py-{self._requests}"


@asynccontextmanager
async def connect(
    url: str,
    *,
    token: str = "",
    rate: int = 24_000,
    seed: int = 0,
) -> AsyncIterator[Avatar]:
    """A session at a server such as `http://127.0.0.1:8765`.

    Raises:
        ConnectionLostError: nobody answers there.
        ProtocolError: the server refused us: wrong token, no free seat.
    """
    hello = Hello(
        token=token,
        audio=AudioFormat(rate=rate),
        seed=seed,
    )
    avatar = Avatar(stream_url(url), hello)
    await avatar.open()
    alive = asyncio.create_task(avatar.keep_alive())
    try:
        yield avatar
    finally:
        alive.cancel()
        await avatar.close()


def stream_url(url: str) -> str:
    """The WebSocket of a server's address, however it was given: with http, with ws, or bare.

    Raises:
        EchoAvatarError: no such address can be.
    """
    parts = urlsplit(url if "://" in url else f"http://{url}")
    schemes = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}
    if parts.scheme not in schemes or not parts.netloc:
        raise EchoAvatarError(f"{url!r} is no server address; give one such as http://127.0.0.1:8765")
    path = parts.path if parts.path.strip("/") else "/v1/stream"
    return urlunsplit((schemes[parts.scheme], parts.netloc, path, "", ""))


def _with(hello: Hello, **changes: Any) -> Hello:

    return msgspec.structs.replace(hello, **changes)


def _pcm(samples: Shaped[np.ndarray, " s"]) -> bytes:
    if samples.ndim != 1:
        raise EchoAvatarError(f"samples of shape {samples.shape}; give one channel, (samples,)")
    if samples.dtype.kind == "f":
        if not np.isfinite(samples).all():
            raise EchoAvatarError("samples hold values that are not finite; replace them by 0")
        return bytes(np.rint(np.clip(samples, -1, 1) * 32_767).astype("<i2").data)
    if samples.dtype == np.int16:
        return bytes(samples.astype("<i2").data)
    raise EchoAvatarError(f"samples of type {samples.dtype}; give floats in -1..1 or int16")
