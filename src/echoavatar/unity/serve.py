"""A server in the published arrangement: audio and actions come in on two ports, motion goes out to the Unity host.

One session. Audio comes as the authors' sender writes it, a pickled array behind its length; it is read by a reader
that builds arrays and nothing else (`reference.untrusted`), where the published server runs whatever it is sent. When
the sound stalls the avatar goes on in silence, at the pace of the clock. A client that is not there yet, or goes away,
is tried again every second; meanwhile motion is dropped, not saved up.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable

import numpy as np
from pydantic import Field

from ..config import Config
from ..engine import Engine, EngineThread, SessionCore
from ..errors import AudioError, CheckpointError, EchoAvatarError
from ..pipeline.rig import RigConfig
from ..reference.untrusted import read_pickled_array
from ..timing import SAMPLE_RATE_HZ
from .message import HEADER, LARGEST, Messages

_LOG = logging.getLogger(__name__)
RETRY_S, TICK_S = 1.0, 0.05
QUEUE = 8  # messages, 3.2 s
STICKY_S = 60.0  # the published server holds an action until the next one; here it ends by itself some time
NO_ACTION = ("none_tem0", "none_tem1", "none_tem2")


class UnitySettings(Config):
    """Who listens where; the defaults are the published ports, on this machine."""

    host: str = Field(default="127.0.0.1", description="address that audio and actions come to")
    audio_port: int = Field(default=12_345, ge=0, le=65_535, description="0 takes any free one")
    action_port: int = Field(default=12_347, ge=0, le=65_535, description="12346 in the release")
    unity_host: str = Field(default="127.0.0.1", description="where the Unity project listens for motion")
    unity_port: int = Field(default=12_346, gt=0, le=65_535, description="its port")


async def serve_unity(
    engine: Engine,
    rig: RigConfig,
    settings: UnitySettings,
    *,
    seed: int = 0,
    on_ready: Callable[[int, int], None] | None = None,
) -> None:
    """Serve until cancelled; `engine` must run on the rig's own bones. `on_ready` is told both ports.

    Raises:
        EchoAvatarError: a port is taken.
        CheckpointError: the bundle has no transforms for Unity.
    """
    messages, out = Messages(rig), asyncio.Queue[bytes](QUEUE)
    session, loop, moved = engine.open_core(seed=seed), asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        loop.call_soon_threadsafe(moved.set)

    session.on_motion = wake
    async with contextlib.AsyncExitStack() as stack:
        stack.callback(session.close)
        stack.enter_context(EngineThread(engine))
        ports = []
        for port, handle in ((settings.audio_port, _hear), (settings.action_port, _obey)):
            ports.append(await _listen(stack, settings.host, port, _handler(handle, session)))
        if on_ready is not None:
            on_ready(*ports)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(_collect(session, messages, moved, out))
            tasks.create_task(_pace(session))
            tasks.create_task(_send(settings, out))


async def _listen(
    stack: contextlib.AsyncExitStack,
    host: str,
    port: int,
    handler: Callable[[asyncio.StreamReader, asyncio.StreamWriter], object],
) -> int:
    try:
        server = await asyncio.start_server(handler, host, port)  # type: ignore[arg-type]
    except OSError as error:
        raise EchoAvatarError(
            f"{host}:{port} cannot be used ({error.strerror}); choose another port"
        ) from error
    await stack.enter_async_context(server)
    return int(server.sockets[0].getsockname()[1])


def _handler(
    handle: Callable[[SessionCore, bytes], None], session: SessionCore
) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], object]:
    """Reads framed payloads until the sender leaves; what cannot be used ends the connection, not the session."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                (size,) = HEADER.unpack(await reader.readexactly(HEADER.size))
                if size > LARGEST:
                    raise CheckpointError(f"a message of {size} bytes is too long")
                handle(session, await reader.readexactly(size))
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass  # cancelled: the server stops, and asyncio would print a trace for each sender that is still there
        except (EchoAvatarError, UnicodeDecodeError) as error:
            _LOG.warning("a sender was turned away: %s", error)
        finally:
            writer.close()

    return serve


def _hear(session: SessionCore, payload: bytes) -> None:
    """A pickled array of samples, 24 kHz; nothing: the source has ended for now."""
    if not payload:
        session.stall()
        return
    samples = np.asarray(read_pickled_array(payload), np.float32).reshape(-1)
    if not np.isfinite(samples).all():
        raise AudioError("the samples are not finite")
    session.push(samples, SAMPLE_RATE_HZ)


def _obey(session: SessionCore, payload: bytes) -> None:
    """The name of an action; others mean none, as published."""
    name = payload.decode("utf-8").strip()
    if name in NO_ACTION or session.act(name, hold_s=STICKY_S).status == "rejected":
        session.stop_acting()


async def _collect(
    session: SessionCore, messages: Messages, moved: asyncio.Event, out: "asyncio.Queue[bytes]"
) -> None:
    while True:
        await moved.wait()
        moved.clear()
        while (delivery := session.take()) is not None:
            for message in messages.push(delivery.motion, delivery.audio):
                if out.full():
                    out.get_nowait()
                out.put_nowait(message)


async def _pace(session: SessionCore) -> None:
    """Once there was sound, a chunk of silence whenever the clock has passed what was made."""
    clock = asyncio.get_running_loop().time
    begun: float | None = None
    while True:
        await asyncio.sleep(TICK_S)
        if begun is None and (session.made or session.is_ready):
            begun = clock()
        if begun is None or session.is_ready:
            continue
        if session.made + session.chunk.samples < (clock() - begun) * SAMPLE_RATE_HZ:
            session.stall()


async def _send(settings: UnitySettings, out: "asyncio.Queue[bytes]") -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection(settings.unity_host, settings.unity_port)
        except OSError:
            await asyncio.sleep(RETRY_S)
            continue
        try:
            while True:
                writer.write(await out.get())
                await writer.drain()
        except ConnectionError:
            _LOG.warning("Unity at %s:%d went away", settings.unity_host, settings.unity_port)
        finally:
            writer.close()
