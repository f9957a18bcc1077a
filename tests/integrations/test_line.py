"""A WebSocket of an application in this process, against an application of ten lines."""

import asyncio
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, ConnectionClosedOK

from echoavatar.integrations.line import MemoryLine


async def parrot(scope: Any, receive: Any, send: Any) -> None:
    assert scope["subprotocols"] == ["echoavatar.v1.msgpack"]
    assert (await receive())["type"] == "websocket.connect"
    await send({"type": "websocket.accept"})
    while (said := await receive())["type"] == "websocket.receive":
        if said["bytes"] == b"bye":
            await send({"type": "websocket.close", "code": 4400, "reason": "no"})
            return
        await send({"type": "websocket.send", "bytes": said["bytes"] * 2})


async def crash(scope: Any, receive: Any, send: Any) -> None:
    raise RuntimeError("broken")


def test_frames_go_both_ways_in_order() -> None:
    async def run() -> None:
        line = MemoryLine(parrot)
        await line.send(b"a")
        await line.send(b"b")
        assert [await line.recv(), await line.recv()] == [b"aa", b"bb"]
        await line.close()
        with pytest.raises(ConnectionClosedOK):
            await line.recv()
        with pytest.raises(ConnectionClosed):
            await line.send(b"c")

    asyncio.run(run())


def test_the_application_may_close_it() -> None:
    async def run() -> None:
        line = MemoryLine(parrot)
        await line.send(b"bye")
        with pytest.raises(ConnectionClosed) as closed:
            await line.recv()
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (4400, "no")
        await line.close()

    asyncio.run(run())


def test_a_reader_learns_that_it_is_over() -> None:
    async def run() -> None:
        line = MemoryLine(parrot)
        reading = asyncio.ensure_future(line.recv())
        await asyncio.sleep(0.01)
        await line.close()
        with pytest.raises(ConnectionClosedOK):
            await reading

    asyncio.run(run())


def test_an_application_that_breaks_is_a_broken_line() -> None:
    async def run() -> None:
        line = MemoryLine(crash)
        with pytest.raises(ConnectionClosed) as closed:
            await line.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1006
        with pytest.raises(RuntimeError, match="broken"):
            await line._visit

    asyncio.run(run())
