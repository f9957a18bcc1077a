"""The `mcp` package's own client against our server: in process, over standard input and over HTTP."""

import asyncio
import contextlib
import http.client
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest
from tests.server.fakes import RunningServer, serving

from echoavatar.agents.client import RemoteTools
from echoavatar.errors import EchoAvatarError
from echoavatar.wire import sockets
from echoavatar.wire.messages import ActionStatus, Hello
from echoavatar.wire.sockets import ConnectionGuard, raise_file_limit

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


def test_without_a_session_it_lists_the_actions_and_says_what_to_open(server: RunningServer) -> None:
    from echoavatar.agents.mcp import create_server

    async def run() -> None:
        async with mcp.Client(create_server(RemoteTools(server.address))) as client:
            tools = {tool.name: tool for tool in (await client.list_tools()).tools}
            assert "wave" in json.dumps(tools["send_action"].input_schema)
            done = await client.call_tool("send_action", {"action": "wave"})
            assert done.is_error
            assert f"open {RemoteTools(server.address).base} in a browser" in done.content[0].text

    assert server.empties()
    asyncio.run(asyncio.wait_for(run(), 20))


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


@contextlib.asynccontextmanager
async def served(tools: RemoteTools, **options: Any) -> AsyncIterator[str]:
    """Our server over HTTP; yields its address."""
    from echoavatar.agents.mcp import serve_http

    address = asyncio.get_running_loop().create_future()
    serving_it = asyncio.create_task(serve_http(tools, port=0, on_ready=address.set_result, **options))
    try:
        yield await asyncio.wait_for(address, 10)
    finally:
        serving_it.cancel()
        await asyncio.wait([serving_it])


def test_over_http(server: RunningServer) -> None:
    async def run() -> None:
        async with served(RemoteTools(server.address)) as address, mcp.Client(f"{address}/mcp") as client:
            await use(client)

    with server.call(Hello()):
        asyncio.run(asyncio.wait_for(run(), 30))


def test_idle_sockets_lock_no_agent_out_and_fill_no_log(
    server: RunningServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Three times as many as there are places; some send half a request, or a body that never comes."""
    monkeypatch.setattr(sockets, "ConnectionGuard", lambda _: ConnectionGuard(20))
    halves = (b"", b"POST /mcp HTTP/1.1\r\n", b"POST /mcp HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n")

    async def run() -> None:
        async with served(RemoteTools(server.address)) as address:
            port = int(address.rpartition(":")[2])
            lines = [await asyncio.open_connection("127.0.0.1", port) for _ in range(60)]
            for number, (_, writer) in enumerate(lines):
                writer.write(halves[number % 3])
            async with mcp.Client(f"{address}/mcp") as client:
                await use(client)
            for reader, _ in lines[:30]:
                with contextlib.suppress(ConnectionError):
                    assert await asyncio.wait_for(reader.read(), 2) == b""
            for _, writer in lines:
                writer.close()

    with server.call(Hello()):
        asyncio.run(asyncio.wait_for(run(), 30))
    assert len(caplog.text) < 10_000


@pytest.mark.slow
def test_more_idle_sockets_than_the_system_allows_files_lock_no_agent_out(server: RunningServer) -> None:
    """As people start it, where no more than 1,024 files may be open."""
    raise_file_limit()
    command = f"ulimit -n 1024; exec {sys.executable} -m echoavatar mcp --http --port 0 --server {server.address}"
    with (
        contextlib.ExitStack() as stack,
        subprocess.Popen(["bash", "-c", command], stderr=subprocess.PIPE) as process,
        server.call(Hello()),
    ):
        stack.callback(process.kill)
        assert process.stderr is not None
        address = process.stderr.readline().decode().split()[4]
        where = ("127.0.0.1", int(address.split(":")[2].split("/")[0]))
        for _ in range(1_100):
            stack.enter_context(socket.create_connection(where))

        async def run() -> None:
            async with mcp.Client(address) as client:
                await use(client)

        for _ in range(3):
            asyncio.run(asyncio.wait_for(run(), 15))
            time.sleep(2)
        process.terminate()
        assert len(process.stderr.read()) < 10_000


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 401),
        ({"Authorization": "Bearer wrong"}, 401),
        ({"Authorization": "Bearer secret", "Origin": "https://evil.example"}, 403),
        ({"Authorization": "Bearer secret", "Origin": "https://good.example"}, 200),
        ({"Authorization": "Bearer secret", "Host": "any.example"}, 200),
    ],
)
def test_whoever_borrows_the_servers_token_needs_one(headers: dict[str, str], status: int) -> None:
    assert asyncio.run(ask(headers, token="secret", origins=("https://good.example",), host="0.0.0.0")) == status


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "evil.example"}, 421),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 421),
        ({"Host": "good.example"}, 200),
        ({"Origin": "https://evil.example"}, 403),
    ],
)
def test_without_a_token_pages_of_other_names_reach_no_tool(headers: dict[str, str], status: int) -> None:
    assert asyncio.run(ask(headers, origins=("https://good.example",))) == status


def test_no_agent_holds_a_connection_open_for_events_that_never_come() -> None:
    assert asyncio.run(ask({}, method="GET")) == 405


async def ask(headers: dict[str, str], *, method: str = "POST", **options: Any) -> int:
    """The status of the first message of an agent that sends these headers."""
    first = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "agent", "version": "1"}}
    body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": first})
    known = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}

    def post(port: int) -> int:
        line = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        line.request(method, "/mcp", body, known | headers)
        with line.getresponse() as answer:
            return answer.status

    async with served(RemoteTools("127.0.0.1:9"), **options) as address:
        return await asyncio.to_thread(post, int(address.rpartition(":")[2]))


async def test_without_a_token_it_listens_on_this_machine_only() -> None:
    from echoavatar.agents.mcp import serve_http

    with pytest.raises(EchoAvatarError, match="give clients a token"):
        await serve_http(RemoteTools("127.0.0.1:9"), host="0.0.0.0", port=0)


async def test_without_a_server_it_says_so() -> None:
    from echoavatar.agents.mcp import create_server

    async with mcp.Client(create_server(RemoteTools("127.0.0.1:9"))) as client:
        done = await client.call_tool("stop_music", {})
        assert done.is_error
        assert "echoavatar serve" in done.content[0].text
        with pytest.raises(Exception, match="echoavatar serve"):
            await client.list_tools()
