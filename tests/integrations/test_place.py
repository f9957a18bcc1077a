"""The same session at both kinds of place."""

import asyncio
import json
import urllib.request
from dataclasses import replace

import pytest
from tests.server.fakes import FAST, Body, serving

from echoavatar.client import ConnectionLostError
from echoavatar.engine import Engine
from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.integrations import Hop, Stage, find_place
from echoavatar.integrations.place import Local
from echoavatar.wire import Hello, ProtocolError


def engine(seats: int = 1) -> Engine:
    return Engine(Body(), seats=seats)  # type: ignore[arg-type]


async def first_hop(stage: Stage) -> Hop:
    async for event in stage:
        if isinstance(event, Hop):
            return event
    raise AssertionError


def test_an_engine_in_this_process_and_a_server_are_one_thing() -> None:
    async def run(where: object) -> tuple[object, ...]:
        place = find_place(where, token="secret")  # type: ignore[arg-type]
        stage = Stage(place)
        ready = await stage.start()
        tools = await place.tools()
        hop = await first_hop(stage)
        await stage.close()
        return ready.actions, ready.rig, tools, hop.at, len(hop.motion.rotations)

    here = asyncio.run(run(engine()))
    with serving(settings=replace(FAST, token="secret")) as there:
        assert asyncio.run(run(f"http://{there.address}")) == here
        page = find_place(f"http://{there.address}", token="secret").page("abc")
        assert page == f"http://{there.address}/?watch=abc#token=secret"


def test_an_engine_here_may_have_a_door_for_pages() -> None:
    async def run() -> None:
        stage = Stage(Local(engine(), port=0))
        ready = await stage.start()
        address, _, session = stage.page.partition("/?watch=")
        assert session == ready.session
        page = await asyncio.to_thread(urllib.request.urlopen, f"{address}/health")
        assert json.loads(page.read())["sessions"] == 1
        await stage.close()

    asyncio.run(run())


def test_without_a_door_there_is_no_page() -> None:
    assert find_place(engine()).page("x") == ""


def test_what_is_not_there_is_told() -> None:
    async def start(where: object, **options: str) -> None:
        await Stage(find_place(where, **options)).start()  # type: ignore[arg-type]

    with pytest.raises(ConnectionLostError, match="echoavatar serve"):
        asyncio.run(start("http://127.0.0.1:9"))
    with pytest.raises(CheckpointError):
        asyncio.run(start("no-such-bundle"))
    with serving(settings=replace(FAST, token="secret")) as there:
        with pytest.raises(ProtocolError):
            asyncio.run(start(f"http://{there.address}", token="wrong"))
        with pytest.raises(ConnectionLostError, match="token"):
            asyncio.run(find_place(f"http://{there.address}", token="wrong").tools())


def test_seats_run_out_and_a_closed_place_stays_closed() -> None:
    async def run() -> None:
        place = Local(engine(1))
        await place.open(Hello())
        with pytest.raises(ProtocolError, match="seats"):
            await place.open(Hello())
        await place.close()
        with pytest.raises(EchoAvatarError, match="closed"):
            await place.open(Hello())

    asyncio.run(run())
