"""Tools over HTTP, for agents without a connection of their own to a session: declarations and calls."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, cast, get_args

import anyio
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from echoavatar.engine.tools import Schema, Style, checked
from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.wire.codec import ProtocolError
from echoavatar.wire.guard import check_origin

from .clients import client_of, refusal
from .session import ServerSession
from .session_manager import SessionManager

SECONDS = 15.0  # for a body to arrive
MOST_BYTES = 16_384
# HTTP statuses of protocol errors; the others have 400.
STATUSES = {"unauthorized": 401, "forbidden_origin": 403, "unknown_session": 404, "overloaded": 429}


async def read_body(request: Request, most: int, *, seconds: float = SECONDS) -> bytes:
    """The whole body. Raises EchoAvatarError if the body has more than `most` bytes, or does not arrive in time."""
    body = bytearray()
    try:
        with anyio.fail_after(seconds):
            async for part in request.stream():
                body += part
                if len(body) > most:
                    raise EchoAvatarError(f"the body has more than {most} bytes")
    except (TimeoutError, ClientDisconnect) as error:
        raise EchoAvatarError(f"the body did not come within {seconds:g} s") from error
    return bytes(body)


def tool_routes(manager: SessionManager) -> list[BaseRoute]:
    """GET /v1/tools, GET /v1/sessions, POST /v1/tools/NAME of `{"session": ..., "arguments": {...}}`."""

    async def declarations(request: Request) -> list[Schema]:
        style = request.query_params.get("style", "plain")
        if style not in get_args(Style):
            raise EchoAvatarError(f"style is one of {', '.join(get_args(Style))}")
        return manager.toolbox.schemas(cast(Style, style))

    async def sessions(request: Request) -> Response:
        if not lists_sessions(manager, request):
            return refusal("this server does not list its sessions; name one", 403)
        return JSONResponse({"sessions": list(manager.names)})

    async def call(request: Request) -> Schema:
        message = await read_json(request, manager.settings.origins)
        arguments = message.get("arguments") or {}
        if not isinstance(arguments, dict):
            raise EchoAvatarError('"arguments" must be an object')
        session = asked_session(manager, request, message)
        await manager.clients.check("commands", client_of(request.scope))
        return await call_tool(manager, session, request.path_params["name"], arguments)

    return [
        Route("/v1/tools", answering(manager, declarations)),
        Route("/v1/tools/{name}", answering(manager, call), methods=["POST"]),
        Route("/v1/sessions", answering(manager, sessions)),
    ]


async def call_tool(manager: SessionManager, session: ServerSession, name: str, arguments: Mapping[str, Any]) -> Schema:
    """Run the tool that a model asked for; failure is an answer, not an exception."""
    try:
        given = checked(manager.toolbox.schemas(), name, arguments)
        match name:
            case "send_action":
                asked = session.act(given["action"], intensity=given.get("intensity", 1.0), hold_s=given.get("hold"))
                reason = {"reason": asked.reason} if asked.reason else {}
                return {"status": asked.status, "id": asked.id, "action": asked.name} | reason
            case "set_manner":
                session.set_manner(**given)
                return {"status": "done"}
            case "play_music":
                title = manager.tracks.find(given.get("title"))
                session.play(title, await manager.load_track(title))
                return {"status": "accepted", "title": title}
            case "stop_music":
                session.stop_music()
                return {"status": "done"}
            case _:
                return {"actions": manager.toolbox.meanings}
    except EchoAvatarError as error:
        return {"status": "rejected", "reason": str(error)}


def answering(
    manager: SessionManager, handle: Callable[[Request], Awaitable[object]], *, failure: int = 400
) -> Callable[[Request], Awaitable[Response]]:
    """An endpoint that answers with the response or JSON that `handle` returns, or with its error (`failure`: status).

    A request without the server's token is refused; an address that sent too many wrong tokens must wait.
    """

    async def answer(request: Request) -> Response:
        try:
            manager.clients.gate.check("", request.headers, client_of(request.scope))
            answer = await handle(request)
            return answer if isinstance(answer, Response) else JSONResponse(answer)
        except ProtocolError as error:
            return refusal(str(error), STATUSES.get(error.code, 400), seconds=error.retry_after)
        except EchoAvatarError as error:
            return refusal(str(error), failure)

    return answer


def readable_by_pages(origins: tuple[str, ...], *methods: str) -> Middleware:
    """Let pages of `origins` and of this machine read a route's answers (CORS), as `check_origin` does."""
    return Middleware(
        CORSMiddleware,
        allow_origins=origins,
        allow_origin_regex=r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?",
        allow_methods=methods,
        allow_headers=("authorization", "content-type"),
        expose_headers=("location",),
    )


def lists_sessions(manager: SessionManager, request: Request) -> bool:
    """Whether this client may know the sessions of others: not on a shared server, and not through a proxy."""
    is_forwarded = any(name in request.headers for name in ("forwarded", "x-forwarded-for"))
    return manager.settings.lists_sessions and not is_forwarded


def asked_session(manager: SessionManager, request: Request, message: dict[str, Any]) -> ServerSession:
    """The session of a request: by its name; without one the newest, if the client may know it.

    Raises ProtocolError if there is no such session, or it has to be named.
    """
    name = message.get("session") or ""
    if not isinstance(name, str) or not (name or lists_sessions(manager, request)):
        raise ProtocolError("unknown_session", "name the session: this server does not list them")
    return manager.find(name)


async def read_json(request: Request, allowed: tuple[str, ...] = (), *, most: int = MOST_BYTES) -> dict[str, Any]:
    """The JSON object in a request of an agent, or of our page.

    Raises:
        ProtocolError: another page sent it.
        EchoAvatarError: it is not a JSON object, too large or too late.
    """
    check_origin(request.headers, allowed)
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":  # a form on another page cannot say so
        raise EchoAvatarError("send application/json")
    return read_object(await read_body(request, most), "the body")
