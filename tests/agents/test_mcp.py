"""The `mcp` package's own client against our server: in process, over standard input and over HTTP."""

import asyncio
import json
import os
import socket
import sys
from collections.abc import Iterator

import pytest
from tests.server.fakes import RunningServer, serving

from echoavatar.agents.client import RemoteTools
from echoavatar.wire.messages import ActionStatus, Hello

mcp = pytest.importorskip("mcp")
NAMES = ["send_action", "play_music", "stop_music", "list_actions"]


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with serving() as server:
        yield server


async def use(client: "mcp.Client") -> None:
    """List the tools, call one, and call one wrongly, as an agent would."""
    listed = await client.list_tools()
    assert [tool.name for tool in listed.tools] == NAMES
    assert listed.tools[0].input_schema["properties"]["action"]["enum"] == ["wave", "bow"]
    done = await client.call_tool("send_action", {"action": "bow"})
    assert not done.is_error
    assert done.structured_content["status"] == "accepted"
    assert json.loads(done.content[0].text) == done.structured_content
    wrong = await client.call_tool("send_action", {"action": "fly"})
    assert wrong.is_error
    assert "there are: wave, bow" in wrong.content[0].text


def test_an_agent_makes_the_avatar_bow(server: RunningServer) -> None:
    from echoavatar.agents.mcp import create_server

    async def run(session: str) -> None:
        async with mcp.Client(create_server(RemoteTools(server.address, session=session))) as client:
            await use(client)

    with server.call(Hello()) as caller:
        asyncio.run(asyncio.wait_for(run(caller.ready.session), 20))
        assert caller.until(ActionStatus).name == "bow"


def test_over_standard_input_as_agents_start_it(server: RunningServer) -> None:
    parameters = mcp.StdioServerParameters(
        command=sys.executable, args=["-m", "echoavatar", "mcp", "--server", server.address], env=dict(os.environ)
    )

    async def run() -> None:
        async with mcp.Client(parameters) as client:
            await use(client)

    with server.call(Hello()) as caller:
        asyncio.run(asyncio.wait_for(run(), 60))
        assert caller.until(ActionStatus).name == "bow"


def test_over_http(server: RunningServer) -> None:
    from echoavatar.agents.mcp import serve_http

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    async def run() -> None:
        serving_it = asyncio.create_task(serve_http(RemoteTools(server.address), port=port))
        await asyncio.sleep(1)
        async with mcp.Client(f"http://127.0.0.1:{port}/mcp") as client:
            await use(client)
        serving_it.cancel()

    with server.call(Hello()):
        asyncio.run(asyncio.wait_for(run(), 30))


async def test_without_a_server_it_says_so() -> None:
    from echoavatar.agents.mcp import create_server

    async with mcp.Client(create_server(RemoteTools("127.0.0.1:9"))) as client:
        done = await client.call_tool("stop_music", {})
        assert done.is_error
        assert "echoavatar serve" in done.content[0].text
        with pytest.raises(Exception, match="echoavatar serve"):
            await client.list_tools()
