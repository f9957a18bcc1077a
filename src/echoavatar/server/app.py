"""The web application: the WebSocket, the page, and what operators and agents ask for."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from .. import __version__
from ..engine import Engine
from .chat import chat_routes
from .endpoint import Visit
from .house import House
from .metrics import CONTENT_TYPE
from .page import page_routes
from .settings import ServerSettings
from .tool_routes import locked, tool_routes
from .voice import voice_route


def create_app(engine: Engine, settings: ServerSettings | None = None) -> Starlette:
    """An ASGI application that serves an engine; its lifespan owns the engine's thread.

    `app.state.house` holds the sessions. Wherever it is mounted, the lifespan must run.
    """
    house = House(engine, settings or ServerSettings())
    app = Starlette(routes=_routes(house), lifespan=_lifespan)
    app.state.house = house
    return app


@asynccontextmanager
async def _lifespan(app: Starlette) -> AsyncIterator[None]:
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(app.state.house.run)
        yield
        tasks.cancel_scope.cancel()


def _routes(house: House) -> list[BaseRoute]:
    async def stream(websocket: WebSocket) -> None:
        await Visit(websocket, house).run()

    async def health(_: Request) -> Response:
        is_ready = house.is_well and not house.is_draining
        state = "ready" if is_ready else "draining" if house.is_draining else "failed"
        facts = {
            "status": state,
            "version": __version__,
            "sessions": house.sessions,
            "seats": house.engine.seats,
            "free": house.engine.free,
        }
        return JSONResponse(facts, 200 if is_ready else 503)

    async def metrics(request: Request) -> Response:
        return locked(house, request) or Response(house.metrics.text(), media_type=CONTENT_TYPE)

    return [
        WebSocketRoute("/v1/stream", stream),
        *tool_routes(house),
        *chat_routes(house),
        Route("/health", health),
        Route("/metrics", metrics),
        voice_route(house.settings.token),
        *page_routes(),
    ]
