"""Both kinds of backend give the same session."""

import asyncio
import json
import urllib.request
from dataclasses import replace

import pytest
from tests.agents.integrations.fakes import engine
from tests.server.fakes import FAST, serving

from echoavatar.agents.client import ConnectionLostError
from echoavatar.agents.integrations import AvatarBridge, AvatarChunk, find_backend
from echoavatar.agents.integrations.backend import LocalBackend
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.messages import Hello


async def first_chunk(bridge: AvatarBridge) -> AvatarChunk:
    async for event in bridge:
        if isinstance(event, AvatarChunk):
            return event
    raise AssertionError


def test_an_engine_in_this_process_behaves_like_a_server() -> None:
    async def run(where: object) -> tuple[object, ...]:
        backend = find_backend(where, token="secret")  # type: ignore[arg-type]
        bridge = AvatarBridge(backend)
        ready = await bridge.start()
        tools = await backend.tools()
        chunk = await first_chunk(bridge)
        await bridge.close()
        return ready.actions, ready.rig, tools, chunk.at, len(chunk.motion.rotations)

    here = asyncio.run(run(engine()))
    with serving(settings=replace(FAST, token="secret")) as there:
        assert asyncio.run(run(f"http://{there.address}")) == here
        page = find_backend(f"http://{there.address}", token="secret").page("abc")
        assert page == f"http://{there.address}/?watch=abc#token=secret"


async def test_an_engine_in_this_process_may_serve_a_page() -> None:
    bridge = AvatarBridge(LocalBackend(engine(), port=0))
    ready = await bridge.start()
    address, _, session = bridge.page.partition("/?watch=")
    assert session == ready.session
    page = await asyncio.to_thread(urllib.request.urlopen, f"{address}/health")
    assert json.loads(page.read())["sessions"] == 1
    await bridge.close()


def test_without_a_port_there_is_no_page() -> None:
    assert find_backend(engine()).page("x") == ""


def test_missing_servers_bundles_and_tokens_are_named() -> None:
    async def start(where: object, **options: str) -> None:
        await AvatarBridge(find_backend(where, **options)).start()  # type: ignore[arg-type]

    with pytest.raises(ConnectionLostError, match="echoavatar serve"):
        asyncio.run(start("http://127.0.0.1:9"))
    with pytest.raises(CheckpointError):
        asyncio.run(start("no-such-bundle"))
    with serving(settings=replace(FAST, token="secret")) as there:
        with pytest.raises(ProtocolError):
            asyncio.run(start(f"http://{there.address}", token="wrong"))
        with pytest.raises(EchoAvatarError, match="token"):
            asyncio.run(find_backend(f"http://{there.address}", token="wrong").tools())


async def test_seats_run_out_and_a_closed_backend_stays_closed() -> None:
    backend = LocalBackend(engine(seats=1))
    await backend.open(Hello())
    with pytest.raises(ProtocolError, match="carries 1 sessions now, and all places are taken"):
        await backend.open(Hello())
    await backend.close()
    with pytest.raises(EchoAvatarError, match="closed"):
        await backend.open(Hello())
