"""The server with a fake Unity project: it receives motion and names actions; hostile senders have no effect."""

import asyncio
import json
import os
import pickle  # noqa: TID251  # what the authors' sender writes
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest
from tests.engine.fakes import FakePipeline

from echoavatar.engine import Engine
from echoavatar.engine.pipeline import Action, ActionLibrary
from echoavatar.engine.pipeline.foreign_rig import RigConfig
from echoavatar.motion.kinematics import Skeleton, SkeletonConfig
from echoavatar.motion.motion_chunk import MotionChunk
from echoavatar_lab.reference.release_rig import AXES
from echoavatar_lab.unity import UnitySettings, serve, serve_unity

RIG = RigConfig(axes=AXES, metres_per_unit=0.01, up=2, unity=(((1, 0, 0), (0, 1, 0), (0, 0, 1)),) * 88)


JOINTS = 88
CHAIN = Skeleton(
    SkeletonConfig(
        names=tuple(f"joint{n}" for n in range(JOINTS)),
        parents=tuple(range(-1, JOINTS - 1)),
        offsets=((0.0, 0.01, 0.0),) * JOINTS,
        parts={"all": tuple(range(JOINTS))},
    )
)


class StandIn(FakePipeline):
    """A pipeline without models: the root's height is the loudness heard, and actions are recorded."""

    actions = ActionLibrary({"wave": Action("wave", (3,), (0, 15), is_set=True)})
    directive_codes = 8
    skeleton = CHAIN  # joint names that the engine does not know

    def __init__(self) -> None:
        self.asked: list[list[int]] = []

    def directive(self, members):
        return members

    def step(self, audio, state, active, *, directive=None, **told):
        self.asked.append([] if directive is None else np.flatnonzero(directive[0]).tolist())
        turns = np.tile(np.float32([1, 0, 0, 0]), (8, JOINTS, 1))
        root = np.full((8, 3), float(np.abs(audio).max()), np.float32)
        return [MotionChunk(turns, root, np.zeros((8, 52), np.float32)) for _ in audio]


def framed(payload: bytes) -> bytes:
    return struct.pack(">I", len(payload)) + payload


class Bomb:
    def __reduce__(self):
        return os.mkdir, ("never-made",)


async def test_motion_goes_out_for_pickled_sound_and_nothing_is_run(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    pipeline = StandIn()
    got: list[dict] = []

    async def unity(reader, writer):
        while True:
            (size,) = struct.unpack(">I", await reader.readexactly(4))
            got.append(json.loads(await reader.readexactly(size)))

    server = await asyncio.start_server(unity, "127.0.0.1", 0)
    ready = asyncio.get_running_loop().create_future()
    settings = UnitySettings(audio_port=0, action_port=0, unity_port=server.sockets[0].getsockname()[1])
    engine = Engine(pipeline, workers=1, rewind=0)
    job = asyncio.create_task(serve_unity(engine, RIG, settings, on_ready=lambda *ports: ready.set_result(ports)))
    audio_port, action_port = await asyncio.wait_for(ready, 10)
    _, hostile = await asyncio.open_connection("127.0.0.1", audio_port)
    hostile.write(framed(pickle.dumps(Bomb())))
    _, endless = await asyncio.open_connection("127.0.0.1", audio_port)
    endless.write(struct.pack(">I", 1 << 31))
    _, act = await asyncio.open_connection("127.0.0.1", action_port)
    act.write(framed(b"wave"))
    _, audio = await asyncio.open_connection("127.0.0.1", audio_port)
    await asyncio.sleep(0.1)
    for _ in range(20):
        audio.write(framed(pickle.dumps(np.full((1000, 1), 0.5, np.float32))))
    audio.write(framed(b""))
    await audio.drain()
    for _ in range(200):
        if len(got) >= 2:
            break
        await asyncio.sleep(0.05)
    job.cancel()
    await asyncio.gather(job, return_exceptions=True)
    for writer in (hostile, endless, act, audio):
        writer.close()
    server.close()
    assert len(got) >= 2
    assert np.shape(got[0]["pose"]) == (24, 88, 4)
    np.testing.assert_allclose(np.array(got[0]["trans"])[:, 1], -0.0 + np.array(got[0]["trans"])[0, 1])
    np.testing.assert_allclose(np.array(got[0]["audio"]), 0.5)
    assert pipeline.asked[0] == [3]
    assert not (tmp_path / "never-made").exists()


@asynccontextmanager
async def port() -> AsyncIterator[tuple[int, list[bytes]]]:
    """One of the two ports, and the payloads that came to it."""
    got: list[bytes] = []

    def take(_: object, payload: bytes) -> None:
        got.append(payload)

    server = await asyncio.start_server(serve._make_handler(take, None), "127.0.0.1", 0)
    async with server:
        yield server.sockets[0].getsockname()[1], got


async def is_closed(reader: asyncio.StreamReader) -> bool:
    with suppress(ConnectionError):
        return await asyncio.wait_for(reader.read(1), 5) == b""
    return True


async def waited(condition: Callable[[], bool]) -> bool:
    for _ in range(200):
        if condition():
            return True
        await asyncio.sleep(0.01)
    return False


def test_a_message_that_is_too_long_ends_its_connection_before_it_is_read() -> None:
    async def talk() -> None:
        async with port() as (number, got):
            for size in (serve.LARGEST + 1, (1 << 32) - 1):
                reader, writer = await asyncio.open_connection("127.0.0.1", number)
                writer.write(struct.pack(">I", size))
                assert await is_closed(reader)
            assert got == []

    asyncio.run(talk())


def test_silent_senders_give_way_and_one_that_speaks_does_not() -> None:
    async def talk() -> None:
        async with port() as (number, got):
            _, speaker = await asyncio.open_connection("127.0.0.1", number)
            speaker.write(framed(b"one"))
            assert await waited(lambda: got == [b"one"])
            silent = [await asyncio.open_connection("127.0.0.1", number) for _ in range(3 * serve.MOST_SENDERS)]
            assert await is_closed(silent[0][0])
            newcomer = (await asyncio.open_connection("127.0.0.1", number))[1]
            for writer, said in ((newcomer, b"two"), (speaker, b"three")):
                writer.write(framed(said))
                assert await waited(lambda said=said: got[-1] == said)
            left = sum([not reader.at_eof() for reader, _ in silent])
            assert left <= serve.MOST_SENDERS

    asyncio.run(talk())


@pytest.mark.parametrize(
    ("sent", "name"),
    [(b"", "IDLE_S"), (b"\0\0", "IDLE_S"), (framed(b"whole"), "IDLE_S"), (framed(b"half")[:-1], "MESSAGE_S")],
    ids=["nothing", "half a header", "a message and no more", "half a message"],
)
def test_a_sender_that_falls_silent_is_disconnected(monkeypatch: pytest.MonkeyPatch, sent: bytes, name: str) -> None:
    monkeypatch.setattr(serve, name, 0.1)

    async def talk() -> None:
        async with port() as (number, _):
            reader, writer = await asyncio.open_connection("127.0.0.1", number)
            writer.write(sent)
            assert await is_closed(reader)

    asyncio.run(talk())


def test_it_is_bound_to_this_machine() -> None:
    settings = UnitySettings()
    assert settings.host == settings.unity_host == "127.0.0.1"
