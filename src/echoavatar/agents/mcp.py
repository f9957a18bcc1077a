"""An MCP server for the tools of a running avatar server; calls act on one of its sessions.

The tools are fetched for each listing, so their enums always name the server's present actions and tracks. A failed
call returns a result with `is_error` for the model to read; no exception is raised. No other room imports the
package `mcp`, which implements the protocol.
"""

import asyncio
import json
from collections.abc import Callable
from typing import Any

import mcp_types as types
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server
from mcp.server.transport_security import TransportSecuritySettings
from mcp.shared.exceptions import MCPError
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from echoavatar import __version__
from echoavatar.errors import EchoAvatarError
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.guard import check_origin, has_token, is_loopback
from echoavatar.wire.sockets import WebServer

from .client import RemoteTools

ABOUT = (
    "A live avatar that moves to what is said. Its gestures and its music are yours: call send_action while you talk, "
    "play_music to make it dance. Nothing needs to be said about a call that was accepted."
)


def create_server(tools: RemoteTools) -> "Server[Any]":
    """Create an MCP server that calls `tools`."""

    async def list_tools(_: object, __: object) -> types.ListToolsResult:
        try:
            declared = await asyncio.to_thread(tools.schemas, "mcp")
        except EchoAvatarError as error:
            raise MCPError(types.INTERNAL_ERROR, str(error)) from error
        return types.ListToolsResult(tools=[types.Tool.model_validate(tool) for tool in declared])

    async def call_tool(_: object, params: types.CallToolRequestParams) -> types.CallToolResult:
        answer = await tools.call_async(params.name, params.arguments or {})
        return types.CallToolResult(
            content=[types.TextContent(text=json.dumps(answer, ensure_ascii=False))],
            structured_content=answer,
            is_error=answer.get("status") == "rejected",
        )

    return Server(
        "echoavatar", version=__version__, instructions=ABOUT, on_list_tools=list_tools, on_call_tool=call_tool
    )


async def serve_stdio(tools: RemoteTools) -> None:
    """Serve over standard input and output until they are closed."""
    server = create_server(tools)
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())


async def serve_http(
    tools: RemoteTools,
    *,
    host: str = "127.0.0.1",
    port: int = 8767,
    token: str = "",
    origins: tuple[str, ...] = (),
    on_ready: Callable[[str], None] | None = None,
) -> None:
    """Serve streamable HTTP at `/mcp` until stopped. `on_ready` is called with the address of the server.

    Each call acts with the token of `tools`, so clients need `token`, if there is one. Without it only this machine may
    connect. Pages of other hosts need an entry in `origins`.

    Raises:
        EchoAvatarError: the port is taken, or other machines would need no token.
    """
    if not token and not is_loopback(host):
        raise EchoAvatarError(f"--host {host} lets other machines call the tools; give clients a token")
    checked_by_us = TransportSecuritySettings(enable_dns_rebinding_protection=False)
    app = create_server(tools).streamable_http_app(
        stateless_http=True, json_response=True, transport_security=checked_by_us
    )

    async def admit(scope: Scope, receive: Receive, send: Send) -> None:
        refusal = None if scope["type"] == "lifespan" else _refusal(scope, token, origins)
        await (refusal or app)(scope, receive, send)

    names = None if token else origins
    server = WebServer(admit, host=host, port=port, names=names, on_ready=on_ready, ws="none", lifespan="on")
    await server.serve()


def _refusal(scope: Scope, token: str, origins: tuple[str, ...]) -> PlainTextResponse | None:
    headers = Headers(scope=scope)
    try:
        check_origin(headers, origins)
    except ProtocolError as error:
        return PlainTextResponse(str(error), 403)
    if not has_token(token, headers):
        return PlainTextResponse("wrong token; send Authorization: Bearer TOKEN", 401)
    if scope["method"] != "POST":  # GET would hold a connection open for events, of which there are none
        return PlainTextResponse("send messages by POST", 405, {"allow": "POST"})
    return None
