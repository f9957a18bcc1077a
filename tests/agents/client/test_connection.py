"""The Python client against a real server."""

import asyncio
import contextlib
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AsyncExitStack

import msgspec
import numpy as np
import pytest
from tests.agents.client.test_recording import READY
from tests.server.fakes import RunningServer, serving
from websockets.asyncio.server import ServerConnection, serve

from echoavatar.agents.client import ConnectionLostError, Recorder, connect
from echoavatar.agents.client.connection import CLOSE_S, Avatar, stream_url
from echoavatar.errors import EchoAvatarError
from echoavatar.motion.stages.modes import MotionOptions
from echoavatar.wire.codec import ProtocolError, encode
from echoavatar.wire.messages import ActionStatus, BodyOptions, Flush, Hello, Limits, Sound


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with serving() as server:
        yield server


def test_it_needs_no_torch() -> None:
    code = "import sys, echoavatar.agents.client; sys.exit('torch' in sys.modules or 'pydantic' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


async def test_a_session_asks_for_a_leash(server: RunningServer) -> None:
    async with connect(server.address, body=BodyOptions(leash_m=0.5)) as avatar:
        core = server.manager.find(avatar.ready.session).core
        assert core.options == MotionOptions(leash_m=0.5)
    with pytest.raises(ProtocolError, match=r"leash_m|body"):
        async with connect(server.address, body=BodyOptions(leash_m=-1)):
            pass


async def test_speech_returns_with_its_motion(server: RunningServer) -> None:
    async with connect(server.address, rate=48_000) as avatar:
        recorder = Recorder(avatar.ready)
        await avatar.speak(np.full(24_000, 0.25, np.float32), end=False)
        seg = await avatar.speak(np.full(24_000, 8_192, np.int16))
        async for message in avatar:
            recorder.take(message)
            if isinstance(message, Sound):
                await avatar.played(avatar.received)
            if recorder.has(seg):
                break
        recording = recorder.recording(seg)
        assert np.count_nonzero(recording.audio > 0.2) == pytest.approx(24_000, abs=200)
        assert recording.rotations.shape[1:] == (52, 4)


async def test_speech_longer_than_the_queue_is_sent_as_there_is_room(server: RunningServer) -> None:
    """Three minutes of speech, of which the queue holds two."""
    async with connect(server.address, rate=8_000) as avatar:
        seg = await avatar.speak(np.full(8_000 * 180, 0.1, np.float32))
        heard = 0
        async for message in avatar:
            if isinstance(message, Sound):
                heard += message.seg == seg
                await avatar.played(avatar.received)
                if heard > 60:
                    break
        assert avatar._utterances.seconds_ahead < 40


async def test_a_broken_connection_resumes_without_loss(server: RunningServer) -> None:
    async with connect(server.address) as avatar:
        recorder = Recorder(avatar.ready)
        name = avatar.ready.session
        await avatar.speak(np.full(48_000, 0.25, np.float32), end=False)
        breaks = 0
        async for message in avatar:
            recorder.take(message)
            if isinstance(message, Sound):
                await avatar.played(avatar.received)
                if message.seg and breaks < 2:
                    breaks += 1
                    _tear(avatar)
                    await avatar.speak(np.full(4_800, 0.25, np.float32), end=breaks == 2)
            if recorder.has(1):
                break
        assert breaks == 2
        assert avatar.ready.session == name
        assert np.count_nonzero(recorder.recording(1).audio) == 57_600


async def test_a_lost_session_is_continued_by_a_new_one(server: RunningServer) -> None:
    """The server forgets the session; the next session continues the sentence where playback was."""
    async with connect(server.address) as avatar:
        recorder = Recorder(avatar.ready)
        name = avatar.ready.session
        seg = await avatar.speak(np.full(72_000, 0.25, np.float32))
        sounds = 0
        async for message in avatar:
            recorder.take(message)
            if isinstance(message, Sound):
                await avatar.played(avatar.received)
                sounds += message.seg == seg
                if sounds == 5 and avatar.ready.session == name:
                    server.manager._keys[avatar.ready.resume].key = "lost"
                    server.manager._keys["lost"] = server.manager._keys.pop(avatar.ready.resume)
                    _tear(avatar)
            if recorder.has(seg):
                break
        assert avatar.ready.session != name
        audio = recorder.recording(seg).audio
        assert np.count_nonzero(audio) == 72_000
        assert np.flatnonzero(audio)[-1] < 72_000 + 3 * 6_400


def _tear(avatar: Avatar) -> None:
    assert avatar._socket is not None
    avatar._socket.transport.abort()


async def test_a_server_that_ends_each_session_at_once_is_not_stormed() -> None:
    calls = 0

    async def hang_up(socket: ServerConnection) -> None:
        nonlocal calls
        calls += 1
        await socket.recv()
        await socket.send(encode(READY))
        await socket.close(1012)

    async with serve(hang_up, "127.0.0.1", 0, compression=None) as liar:
        port = next(iter(liar.sockets)).getsockname()[1]
        async with connect(f"127.0.0.1:{port}") as avatar:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.7):
                    async for _ in avatar:
                        pass
    assert 2 <= calls <= 4


@pytest.mark.parametrize("seconds", [0.0, -5.0, float("nan")])
async def test_pings_are_no_flood_whatever_the_server_asks_for(seconds: float) -> None:
    sent: list[object] = []
    avatar = Avatar("ws://127.0.0.1:9", Hello())
    avatar.ready = msgspec.structs.replace(READY, limits=Limits(ping_seconds=seconds))
    avatar.send = sent.append  # type: ignore[method-assign, assignment]
    with contextlib.suppress(TimeoutError, TypeError):
        await asyncio.wait_for(avatar.keep_alive(), 0.05)
    assert not sent


async def test_what_was_not_read_does_not_hold_up_the_end() -> None:
    async def answer(socket: ServerConnection) -> None:
        await socket.recv()
        await socket.send(encode(READY))
        for at in range(200):  # the library reads some ahead
            await socket.send(encode(Sound(at=at, epoch=0, seg=0, pcm=bytes(2))))
        await socket.wait_closed()

    async with serve(answer, "127.0.0.1", 0, compression=None) as place:
        port = place.sockets[0].getsockname()[1]
        async with connect(f"http://127.0.0.1:{port}"):
            await asyncio.sleep(0.2)
            began = asyncio.get_running_loop().time()
        assert asyncio.get_running_loop().time() - began < CLOSE_S / 2


async def test_whoever_reads_while_the_session_is_closed_hears_of_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader handles a message when the closing begins, and asks for the next while it lasts."""

    async def answer(socket: ServerConnection) -> None:
        await socket.recv()
        await socket.send(encode(READY))
        await socket.send(encode(Sound(at=0, epoch=0, seg=0, pcm=bytes(2))))
        await socket.wait_closed()

    has_one = asyncio.Event()

    async def draw(avatar: Avatar) -> None:
        async for _ in avatar:
            has_one.set()
            await asyncio.sleep(0.1)

    async with serve(answer, "127.0.0.1", 0, compression=None) as place:
        port = place.sockets[0].getsockname()[1]
        async with connect(f"http://127.0.0.1:{port}") as avatar:
            drawing = asyncio.create_task(draw(avatar))
            await asyncio.wait_for(has_one.wait(), 5)
            end = avatar._socket.close

            async def end_slowly() -> None:
                await asyncio.sleep(0.4)
                await end()

            monkeypatch.setattr(avatar._socket, "close", end_slowly)
        await asyncio.wait_for(drawing, 5)


@pytest.mark.parametrize("is_open", [True, False])
async def test_a_session_that_is_closed_is_not_opened_again_by_its_reader(
    is_open: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection breaks while it is closed, as where a busy server says no farewell in time, or just before."""
    came, breaks, again = list[ServerConnection](), asyncio.Event(), asyncio.Event()

    async def answer(socket: ServerConnection) -> None:
        came.append(socket)
        await socket.recv()
        if len(came) == 1:
            await socket.send(encode(READY))
            await breaks.wait()
            socket.transport.abort()
        else:
            again.set()
            await socket.wait_closed()

    async def draw(avatar: Avatar) -> None:
        async for _ in avatar:
            pass

    async def end_without_farewell() -> None:
        breaks.set()
        await avatar._socket.wait_closed()

    async with serve(answer, "127.0.0.1", 0, compression=None) as place:
        port = place.sockets[0].getsockname()[1]
        async with connect(f"http://127.0.0.1:{port}") as avatar:
            drawing = asyncio.create_task(draw(avatar))
            if is_open:
                await asyncio.sleep(0.1)
                monkeypatch.setattr(avatar._socket, "close", end_without_farewell)
            else:
                breaks.set()
                await asyncio.wait_for(again.wait(), 5)
        await asyncio.wait_for(drawing, 5)
        assert len(came) == 2 - is_open


async def test_interrupt_act_and_music(server: RunningServer) -> None:
    async with connect(server.address) as avatar:
        await avatar.speak(np.full(96_000, 0.25, np.float32), words=[("hello", 0.5, 0.9), ("you", 2.0)])
        action = await avatar.act("wave", intensity=0.5)
        await avatar.set_manner(liveliness=0.3)
        music = await avatar.play_music()
        seen: set[str] = set()
        async for message in avatar:
            match message:
                case ActionStatus(id=id, status="started"):
                    seen.add(id)
                    if seen == {action, music}:
                        await avatar.stop_music()
                        await avatar.interrupt()
                case Flush(seg=seg) if seg:
                    assert seg == 1
                    break
        assert await avatar.speak(np.zeros(10, np.float32)) == 2


def test_refusals_raise_errors_with_an_explanation(server: RunningServer) -> None:
    async def run(url: str) -> None:
        async with connect(url):
            pass

    with pytest.raises(ConnectionLostError, match="echoavatar serve"):
        asyncio.run(run("http://127.0.0.1:9"))
    with pytest.raises(ProtocolError, match="carries 4 sessions now, and all places are taken"):
        asyncio.run(_crowd(server))


async def _crowd(server: RunningServer) -> None:
    async with AsyncExitStack() as stack:
        for _ in range(5):
            await stack.enter_async_context(connect(server.address))


@pytest.mark.parametrize(
    ("given", "url"),
    [
        ("127.0.0.1:8765", "ws://127.0.0.1:8765/v1/stream"),
        ("https://a.example/", "wss://a.example/v1/stream"),
        ("ws://a.example/other", "ws://a.example/other"),
    ],
)
def test_addresses_may_have_any_usual_form(given: str, url: str) -> None:
    assert stream_url(given) == url


@pytest.mark.parametrize(
    "address", ["ftp://a.example", "a.example:99999", "a.example:port", "http://[::1", "http://a..b", "http://:80"]
)
def test_invalid_addresses_are_refused(address: str) -> None:
    with pytest.raises(EchoAvatarError, match="is not a server address"):
        stream_url(address)


def test_invalid_samples_are_refused(server: RunningServer) -> None:

    async def run(samples: np.ndarray) -> None:
        async with connect(server.address) as avatar:
            await avatar.speak(samples)

    for samples in (np.array([np.nan]), np.zeros((4, 2)), np.zeros(4, np.int64)):
        with pytest.raises(EchoAvatarError):
            asyncio.run(run(samples))
