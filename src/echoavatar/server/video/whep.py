"""WHEP (draft-ietf-wish-whep): a session as WebRTC video and sound, for any player that takes a URL.

POST an SDP offer to `/v1/sessions/NAME/whep` (or to `/v1/whep`: the newest session), get the answer and the address of
the viewer, DELETE that to end it. Each viewer has a renderer of its own; there are as many as the operator allows.
"""

import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

import anyio.to_thread
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from echoavatar.errors import EchoAvatarError
from echoavatar.files.avatar import CHARACTERS
from echoavatar.files.avatar.avatar_renderer import VIEWS, Shot, View
from echoavatar.wire import ProtocolError
from echoavatar.wire.guard import check_origin

from ..body import read_body
from ..session import ServerSession
from ..session_manager import SessionManager
from ..tool_routes import STATUSES, asked_session, locked
from .video_source import VideoSource, prepare
from .viewer import Viewer

MOST_BYTES = 65_536
RETRY_S = 5
PAGE = ("video.html", "video.js")


@dataclass(frozen=True)
class Wish:
    """What a viewer asks for in the query of its address."""

    character: str
    view: View
    background: str

    @classmethod
    def of(cls, request: Request) -> "Wish":
        """Raises EchoAvatarError for a character or view that is not there."""
        query = request.query_params
        character, view = query.get("character", CHARACTERS[0]), query.get("view", VIEWS[0])
        if character not in CHARACTERS:
            raise EchoAvatarError(f"there is no character {character[:40]!r}; choose from {', '.join(CHARACTERS)}")
        if view not in VIEWS:
            raise EchoAvatarError(f"there is no view {view[:40]!r}; choose from {', '.join(VIEWS)}")
        return cls(character, view, query.get("background", "studio")[:40])


class VideoDesk:
    """All WebRTC viewers of a server."""

    def __init__(self, manager: SessionManager) -> None:
        """Reads and draws the first character, so that the first viewer does not wait for that."""
        self._manager, self._settings = manager, manager.settings
        self._viewers: dict[str, Viewer] = {}
        self._taken = 0  # renderers, also of viewers that are being answered or are ending
        prepare(Shot(self._settings.video_size, renderer=self._settings.video_renderer))

    @property
    def free(self) -> int:
        """How many more viewers there can be."""
        return self._settings.video - self._taken

    async def close(self) -> None:
        """End all viewers."""
        for viewer in list(self._viewers.values()):
            await viewer.close()

    def routes(self) -> list[BaseRoute]:
        """The endpoint, its viewers, and the page that plays it."""
        cors = Middleware(
            CORSMiddleware,
            allow_origins=self._settings.origins,
            allow_methods=("POST", "DELETE"),
            allow_headers=("authorization", "content-type"),
            expose_headers=("location",),
        )
        return [
            Route("/v1/whep", self._begin, methods=["POST", "OPTIONS"], middleware=[cors]),
            Route("/v1/sessions/{session}/whep", self._begin, methods=["POST", "OPTIONS"], middleware=[cors]),
            Route("/v1/whep/{viewer}", self._end, methods=["DELETE", "OPTIONS"], middleware=[cors]),
            Route("/video", _asset(PAGE[0], "text/html")),
            Route("/video.js", _asset(PAGE[1], "text/javascript")),
        ]

    async def _begin(self, request: Request) -> Response:
        if (refusal := locked(self._manager, request)) is not None:
            return refusal
        try:
            check_origin(request.headers, self._settings.origins)
            if "application/sdp" not in request.headers.get("content-type", ""):
                return _refusal(415, "send application/sdp")
            session = asked_session(self._manager, request, dict(request.path_params))
            wish, offer = Wish.of(request), await read_body(request, MOST_BYTES)
            if not self.free:
                retry = {"retry-after": str(RETRY_S)}
                return _refusal(503, f"all {self._settings.video} renderers are taken; try again later", retry)
            name, answer = await self._answer(session, wish, offer.decode("utf-8", "replace"))
        except ProtocolError as error:
            return _refusal(STATUSES.get(error.code, 400), str(error))
        except EchoAvatarError as error:
            return _refusal(400, str(error))
        return Response(answer, 201, {"location": f"/v1/whep/{name}"}, "application/sdp")

    async def _answer(self, session: ServerSession, wish: Wish, offer: str) -> tuple[str, str]:
        """Seat a viewer; returns its name and the SDP answer."""
        self._taken += 1
        shot = Shot(self._settings.video_size, wish.view, wish.background, renderer=self._settings.video_renderer)
        try:
            make = partial(VideoSource, self._manager.rig, shot, character=wish.character)
            source = await anyio.to_thread.run_sync(make)
        except BaseException:
            self._taken -= 1
            raise
        name = secrets.token_urlsafe(16)
        viewer = Viewer(session, source, self._settings.ice_servers, lambda: self._free(name))
        self._viewers[name] = viewer
        self._manager.metrics.viewers.set(self._taken)
        try:
            return name, await viewer.answer(offer)
        except BaseException:
            await viewer.close()
            raise

    def _free(self, name: str) -> None:
        viewer = self._viewers.pop(name)
        self._taken -= 1
        metrics = self._manager.metrics
        metrics.viewers.set(self._taken)
        metrics.pictures.labels("shown").inc(viewer.stream.shown)
        metrics.pictures.labels("skipped").inc(viewer.stream.skipped)

    async def _end(self, request: Request) -> Response:
        if (refusal := locked(self._manager, request)) is not None:
            return refusal
        viewer = self._viewers.get(request.path_params["viewer"])
        if viewer is None:
            return _refusal(404, "there is no such viewer, or it has ended")
        await viewer.close()
        return Response(status_code=200)


def _refusal(status: int, reason: str, headers: dict[str, str] | None = None) -> Response:
    return JSONResponse({"error": reason}, status, headers)


def _asset(name: str, kind: str) -> Callable[[Request], Awaitable[Response]]:
    async def answer(_: Request) -> Response:
        path = Path(str(files("echoavatar"))) / "assets" / name
        return Response(await anyio.to_thread.run_sync(path.read_bytes), media_type=kind)

    return answer
