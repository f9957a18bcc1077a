"""The companion behind the page's chat box: text in, text out, and the actions that go with it in the session."""

from functools import lru_cache
from typing import Any

from starlette.requests import Request
from starlette.routing import BaseRoute, Route

from echoavatar.errors import EchoAvatarError
from echoavatar.wire.guard import check_origin

from .companion import MAX_HISTORY_TURNS, ChatTurn, Companion, ToolAccess, from_environment
from .session_manager import SessionManager
from .tool_routes import answering, asked_session, call_tool, read_body, read_json

MOST_LETTERS = 2_000
MOST_SOUND = 4 << 20  # bytes: 80 s at 24 kHz


def chat_routes(manager: SessionManager) -> list[BaseRoute]:
    """The companion's name (GET /v1/chat), its reply to `{"session", "text", "history"}` (POST), and transcription."""
    companion = lru_cache(maxsize=1)(from_environment)

    async def name(_: Request) -> dict[str, Any]:
        return {"name": companion().name, "hears": companion().hears}

    async def talk(request: Request) -> dict[str, Any]:
        return await _talk(manager, companion(), request)

    async def hear(request: Request) -> dict[str, Any]:
        return {"text": await companion().transcribe(await _sound(manager, request))}

    return [
        Route("/v1/chat", answering(manager, name, failure=503)),
        Route("/v1/chat", answering(manager, talk), methods=["POST"]),
        Route("/v1/chat/ears", answering(manager, hear), methods=["POST"]),
    ]


async def _talk(manager: SessionManager, companion: Companion, request: Request) -> dict[str, Any]:
    message = await read_json(request, manager.settings.origins, most=1 << 16)
    text = message.get("text")
    if not isinstance(text, str) or not text.strip() or len(text) > MOST_LETTERS:
        raise EchoAvatarError(f'send {{"text": "..."}} of at most {MOST_LETTERS} letters')
    session = asked_session(manager, request, message)
    did: list[dict[str, Any]] = []

    async def do(name: str, arguments: dict[str, Any]) -> dict[str, Any]:
        result = await call_tool(manager, session, name, arguments)
        did.append({"name": name, "arguments": arguments, "status": result.get("status", "done")})
        return result

    doing = ToolAccess(manager.toolbox.schemas("openai-chat"), do)
    return {"say": await companion.reply(text, _history(message.get("history")), doing), "did": did}


def _history(given: Any) -> list[ChatTurn]:
    """The turns of the conversation so far; entries of the wrong shape are left out."""
    rows = given[-MAX_HISTORY_TURNS:] if isinstance(given, list) else []
    return [
        ChatTurn(row["role"], row["text"][:MOST_LETTERS])
        for row in rows
        if isinstance(row, dict) and row.get("role") in ("user", "assistant") and isinstance(row.get("text"), str)
    ]


async def _sound(manager: SessionManager, request: Request) -> bytes:
    check_origin(request.headers, manager.settings.origins)
    if request.headers.get("content-type") != "audio/wav":  # a form on another page cannot say so
        raise EchoAvatarError("send audio/wav")
    return await read_body(request, MOST_SOUND)
