"""The web application: the WebSocket, the page, and the routes of operators and agents."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import anyio
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from echoavatar import __version__
from echoavatar.engine import Engine

from .clients import RequestPace
from .companion import chat_routes
from .connection import Connection
from .metrics import CONTENT_TYPE
from .page import PageHeaders, page_routes
from .session_manager import SessionManager
from .settings import ServerSettings
from .tool_routes import answering, tool_routes
from .voice import voice_route

if TYPE_CHECKING:
    from .whep import VideoDesk


def create_app(engine: Engine, settings: ServerSettings | None = None) -> Starlette:
    """An ASGI application that serves an engine; its lifespan owns the engine's thread.

    `app.state.manager` holds the sessions. The lifespan must run, also if the application is mounted in another.
    """
    manager = SessionManager(engine, settings or ServerSettings())
    guards = [Middleware(PageHeaders), Middleware(RequestPace, manager.clients)]
    desk = None
    if manager.settings.video:
        from .whep import VideoDesk  # loads aiortc

        desk = VideoDesk(manager)
    app = Starlette(routes=_routes(manager, desk), lifespan=_lifespan, middleware=guards)
    app.state.manager, app.state.video = manager, desk
    return app


@asynccontextmanager
async def _lifespan(app: Starlette) -> AsyncIterator[None]:
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(app.state.manager.run)
        yield
        if app.state.video is not None:
            await app.state.video.close()
        tasks.cancel_scope.cancel()


def _routes(manager: SessionManager, desk: "VideoDesk | None") -> list[BaseRoute]:
    async def stream(websocket: WebSocket) -> None:
        await Connection(websocket, manager).run()

    async def health(_: Request) -> Response:
        is_ready = manager.is_well and not manager.is_draining
        not_ready = "draining" if manager.is_draining else "failed" if manager.failure else "restarting"
        state = "ready" if is_ready else not_ready
        facts = {
            "status": state,
            "version": __version__,
            "sessions": manager.sessions,
            "seats": manager.engine.seats,
            "free": max(0, manager.engine.free),
        }
        if desk is not None:
            facts["video"] = {"viewers": manager.settings.video, "free": desk.free}
        return JSONResponse(facts, 200 if is_ready else 503)

    async def metrics(_: Request) -> Response:
        return Response(manager.metrics.text(), media_type=CONTENT_TYPE)

    return [
        WebSocketRoute("/v1/stream", stream),
        *tool_routes(manager),
        *chat_routes(manager),
        Route("/health", health),
        Route("/metrics", answering(manager, metrics)),
        voice_route(manager),
        *(desk.routes() if desk is not None else ()),
        *page_routes(),
    ]
