"""The live page: the built client, our character and the bundled sounds, all served from here."""

import gzip
from collections.abc import Awaitable, Callable
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import anyio.to_thread
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

SOUNDS = ("speech.ogg", "music.ogg")
_FOR_ALL = {"cache-control": "max-age=3600", "access-control-allow-origin": "*"}  # pages of other sites may load these
_HEADERS = {
    b"content-security-policy": b"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    b"img-src 'self' data: blob:; media-src 'self' blob:; connect-src 'self' ws: wss: blob: data:; "
    b"worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'",
    b"cache-control": b"no-cache",  # revalidated each time, sent again only if it changed
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-opener-policy": b"same-origin",
}
_PLAIN = """<!doctype html><title>EchoAvatar</title>
<h1>EchoAvatar is running</h1>
<p>The page is not built into this installation. Clients connect to <code>/v1/stream</code>;
see <a href="/health">health</a>, <a href="/v1/tools">tools</a>.</p>
"""


def page_routes() -> list[BaseRoute]:
    """Routes of the page. They match every address, so they come last."""
    package = Path(str(files("echoavatar")))
    static, assets = package / "server" / "static", package / "assets"
    routes: list[BaseRoute] = [Route("/avatar.glb", _avatar)]
    routes += [Route(f"/sounds/{name}", _file(assets / name)) for name in SOUNDS]
    if (static / "index.html").is_file():
        return [*routes, Mount("/", GZipMiddleware(StaticFiles(directory=static, html=True), compresslevel=6))]
    return [*routes, Route("/", _plain)]


class PageHeaders:
    """Adds headers that let a page load from, connect to and be framed by this server only, to every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and add the headers that the answer lacks."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                there = {name for name, _ in message["headers"]}
                extra = [(name, value) for name, value in _HEADERS.items() if name not in there]
                message = {**message, "headers": [*message["headers"], *extra]}
            await send(message)

        await self._app(scope, receive, with_headers)


def _file(path: Path) -> Callable[[Request], Awaitable[Response]]:
    async def answer(_: Request) -> Response:
        data = await anyio.to_thread.run_sync(path.read_bytes)
        return Response(data, media_type="audio/ogg", headers=_FOR_ALL)

    return answer


async def _avatar(request: Request) -> Response:
    from echoavatar.files.avatar import CHARACTERS

    name = request.query_params.get("character", CHARACTERS[0])
    if name not in CHARACTERS:
        return PlainTextResponse(f"choose a character from {', '.join(CHARACTERS)}\n", 404)
    data = await anyio.to_thread.run_sync(_character, name)
    headers = {**_FOR_ALL, "vary": "Accept-Encoding"}
    if "gzip" not in request.headers.get("accept-encoding", ""):
        data = gzip.decompress(data)
    else:
        headers["content-encoding"] = "gzip"
    return Response(data, media_type="model/gltf-binary", headers=headers)


@lru_cache
def _character(name: str) -> bytes:
    """A character's GLB, gzipped."""
    from echoavatar.files.avatar import load_character
    from echoavatar.files.avatar.gltf import pack_glb

    return gzip.compress(pack_glb(load_character(name), []), 6)


async def _plain(_: Request) -> Response:
    return HTMLResponse(_PLAIN)
