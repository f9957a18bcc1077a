"""A WebSocket to a minimal application in this process."""

import asyncio
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, ConnectionClosedOK

from echoavatar.agents.integrations.in_process_socket import InProcessSocket


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


async def test_frames_go_both_ways_in_order() -> None:
    socket = InProcessSocket(parrot)
    await socket.send(b"a")
    await socket.send(b"b")
    assert [await socket.recv(), await socket.recv()] == [b"aa", b"bb"]
    await socket.close()
    with pytest.raises(ConnectionClosedOK):
        await socket.recv()
    with pytest.raises(ConnectionClosed):
        await socket.send(b"c")


async def test_the_application_may_close_it() -> None:
    socket = InProcessSocket(parrot)
    await socket.send(b"bye")
    with pytest.raises(ConnectionClosed) as closed:
        await socket.recv()
    assert closed.value.rcvd is not None
    assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (4400, "no")
    await socket.close()


async def test_a_reader_learns_that_it_is_over() -> None:
    socket = InProcessSocket(parrot)
    reading = asyncio.ensure_future(socket.recv())
    await asyncio.sleep(0.01)
    await socket.close()
    with pytest.raises(ConnectionClosedOK):
        await reading


async def test_an_application_that_breaks_is_a_broken_line() -> None:
    socket = InProcessSocket(crash)
    with pytest.raises(ConnectionClosed) as closed:
        await socket.recv()
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1006
    with pytest.raises(RuntimeError, match="broken"):
        await socket._serving
