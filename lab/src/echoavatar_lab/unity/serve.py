"""A server laid out like the published one: audio and actions arrive on two ports, motion goes to the Unity host.

It serves one session. The authors' sender writes audio as a pickled array. The published server unpickles whatever
arrives; here `files.foreign_files` reads arrays and nothing else. When the sound stalls, the avatar continues in
silence at the pace of the clock. While Unity is not reachable, the server retries every second and drops motion.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable

import numpy as np
from pydantic import Field

from echoavatar.config import Config
from echoavatar.engine import Engine, EngineThread, SessionCore
from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.errors import AudioError, CheckpointError, EchoAvatarError
from echoavatar.timing import SAMPLE_RATE_HZ
from echoavatar.wire.sockets import BACKLOG, listen, log_less, raise_file_limit
from echoavatar_lab.foreign.foreign_files import read_pickled_array
from echoavatar_lab.unity.frames import HEADER, LARGEST, Messages

_LOG = logging.getLogger(__name__)
RETRY_S, TICK_S = 1.0, 0.05
QUEUE = 8  # messages of 0.4 s
MOST_SENDERS = 8  # connections to one port; each may hold one message of `LARGEST` bytes
MESSAGE_S = 10.0  # for the rest of a message whose length has come
IDLE_S = 600.0  # between messages; a sender of actions may wait for a person
ACTION_HOLD_S = 60.0  # the published server holds an action until the next one; here it ends after this time
NO_ACTION = ("none_tem0", "none_tem1", "none_tem2")


class UnitySettings(Config):
    """Addresses and ports; the defaults are the published ports, on this machine."""

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
    """Serve until cancelled; `engine` must run on the rig's own bones. `on_ready` receives both ports.

    Raises:
        EchoAvatarError: a port is taken.
        CheckpointError: the bundle has no transforms for Unity.
    """
    messages, out = Messages(rig), asyncio.Queue[bytes](QUEUE)
    session, loop, has_motion = engine.open_core(seed=seed), asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        loop.call_soon_threadsafe(has_motion.set)

    session.on_motion = wake
    async with contextlib.AsyncExitStack() as stack:
        stack.callback(session.close)
        threads = stack.enter_context(EngineThread(engine))
        ports = []
        for port, handle in ((settings.audio_port, _receive_audio), (settings.action_port, _receive_action)):
            ports.append(await _listen(stack, settings.host, port, _make_handler(handle, session)))
        if on_ready is not None:
            on_ready(*ports)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(_pack_motion(session, messages, has_motion, out))
            tasks.create_task(_fill_silence(session, threads))
            tasks.create_task(_send_motion(settings, out))


async def _listen(
    stack: contextlib.AsyncExitStack,
    host: str,
    port: int,
    handler: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
) -> int:
    log_less()
    raise_file_limit()
    server = await asyncio.start_server(handler, sock=listen(host, port), backlog=BACKLOG)
    await stack.enter_async_context(server)
    return int(server.sockets[0].getsockname()[1])


def _make_handler(
    handle: Callable[[SessionCore, bytes], None], session: SessionCore
) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]:
    """Read framed payloads until the sender leaves. An invalid payload ends its connection, not the session.

    If all places are taken, the sender that has been silent for longest gives way, first one that has sent nothing.
    """
    silent: dict[asyncio.StreamWriter, None] = {}  # the oldest first
    heard: dict[asyncio.StreamWriter, None] = {}  # the one with the oldest message first

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(silent) + len(heard) >= MOST_SENDERS:
            group = silent or heard
            oldest = next(iter(group))
            del group[oldest]
            oldest.transport.abort()
        silent[writer] = None
        try:
            while True:
                async with asyncio.timeout(IDLE_S):
                    (size,) = HEADER.unpack(await reader.readexactly(HEADER.size))
                if size > LARGEST:
                    raise CheckpointError(f"a message of {size} bytes is too long")
                async with asyncio.timeout(MESSAGE_S):
                    payload = await reader.readexactly(size)
                handle(session, payload)
                if writer in silent or writer in heard:  # it has not had to give way meanwhile
                    silent.pop(writer, None)
                    heard.pop(writer, None)
                    heard[writer] = None
        except TimeoutError:
            _LOG.warning("a sender was disconnected: it fell silent")
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass  # cancelled when the server stops; asyncio would print a trace for each open connection
        except (EchoAvatarError, UnicodeDecodeError) as error:
            _LOG.warning("a sender was disconnected: %s", error)
        finally:
            silent.pop(writer, None)
            heard.pop(writer, None)
            writer.close()

    return serve


def _receive_audio(session: SessionCore, payload: bytes) -> None:
    """A pickled array of samples at 24 kHz; an empty payload means that the source has paused."""
    if not payload:
        session.stall()
        return
    samples = np.asarray(read_pickled_array(payload), np.float32).reshape(-1)
    if not np.isfinite(samples).all():
        raise AudioError("the samples are not finite")
    session.push(samples, SAMPLE_RATE_HZ)


def _receive_action(session: SessionCore, payload: bytes) -> None:
    """The name of an action; any other name ends the present action, as in the published server."""
    name = payload.decode("utf-8").strip()
    if name in NO_ACTION or session.act(name, hold_s=ACTION_HOLD_S).status == "rejected":
        session.stop_acting()


async def _pack_motion(
    session: SessionCore, messages: Messages, has_motion: asyncio.Event, out: "asyncio.Queue[bytes]"
) -> None:
    while True:
        await has_motion.wait()
        has_motion.clear()
        while (delivery := session.take()) is not None:
            for message in messages.push(delivery.motion, delivery.audio):
                if out.full():
                    out.get_nowait()
                out.put_nowait(message)


async def _fill_silence(session: SessionCore, threads: EngineThread) -> None:
    """After the first sound, push a chunk of silence whenever the clock has passed the motion made.

    Raises EchoAvatarError if the session or the engine failed for good.
    """
    clock = asyncio.get_running_loop().time
    begun: float | None = None
    while True:
        await asyncio.sleep(TICK_S)
        if (fault := session.error or threads.error) is not None:
            raise EchoAvatarError(f"the engine failed: {fault}") from fault
        if begun is None and (session.made or session.is_ready):
            begun = clock()
        if begun is None or session.is_ready:
            continue
        if session.made + session.chunk.samples < (clock() - begun) * SAMPLE_RATE_HZ:
            session.stall()


async def _send_motion(settings: UnitySettings, out: "asyncio.Queue[bytes]") -> None:
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
            _LOG.warning("the connection to Unity at %s:%d was lost", settings.unity_host, settings.unity_port)
        finally:
            writer.close()
