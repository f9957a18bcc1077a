"""The live page: the built client, our character and the bundled sounds, all served from here."""

import gzip
from collections.abc import Awaitable, Callable, Mapping
from functools import lru_cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

import anyio.to_thread
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from echoavatar.files.avatar import CHARACTERS, LEVELS, level_file, load_character
from echoavatar.files.avatar.gltf import pack_glb

SOUNDS = ("speech.ogg", "music.ogg")
_SHARED = {"access-control-allow-origin": "*"}  # pages of other sites may load these
_FOR_ALL = {"cache-control": "max-age=3600", **_SHARED}
_HEADERS = {
    # WebAssembly decodes the avatar's mesh.
    b"content-security-policy": b"default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; "
    b"style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; media-src 'self' blob:; "
    b"connect-src 'self' ws: wss: blob: data:; "
    b"worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'",
    b"cache-control": b"no-cache",  # revalidated each time, sent again only if it changed
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-opener-policy": b"same-origin",
}
# A worker has the policy of its own answer. The one that unpacks KTX2 evaluates code, and reaches nothing but its page.
_TRANSCODER = "default-src 'none'; script-src 'self' 'unsafe-eval' 'wasm-unsafe-eval'; connect-src 'none'"


def page_routes() -> list[BaseRoute]:
    """Routes of the page. They match every address, so they come last."""
    package = Path(str(files("echoavatar")))
    static, assets = package / "server" / "static", package / "assets"
    routes: list[BaseRoute] = [Route("/avatar.glb", _avatar)]
    routes += [Route(f"/sounds/{name}", file_answer(assets / name, "audio/ogg", _FOR_ALL)) for name in SOUNDS]
    text = (static / "index.html").read_text("utf-8").replace("maya theo amara", " ".join(CHARACTERS))
    routes.append(Route("/", _index(text)))
    built = _Built(directory=static / "assets", packages=[("echoavatar", "assets/shared")])
    routes.append(Mount("/assets", GZipMiddleware(built, compresslevel=6)))
    return [*routes, Mount("/", GZipMiddleware(_Static(directory=static), compresslevel=6))]


class _Static(StaticFiles):
    """Files that pages of other sites may load, as `/client/echo-avatar.js` and what it imports."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        answer = await super().get_response(path, scope)
        answer.headers.update(_SHARED)
        return answer


class _Built(_Static):
    """Built files. Their names hold a hash of their content, so a browser may keep them for ever."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        answer = await super().get_response(path, scope)
        if answer.status_code == 200:
            answer.headers["cache-control"] = "public, max-age=31536000, immutable"
            if path.startswith("transcode-"):
                answer.headers["content-security-policy"] = _TRANSCODER
        return answer


def _index(text: str) -> Callable[[Request], Awaitable[Response]]:
    """The page. It requests the character of its address before its script runs."""

    async def answer(request: Request) -> Response:
        name = request.query_params.get("character", "")
        wished = f"avatar.glb?character={name}&amp;level=2" if name in CHARACTERS[1:] else "avatar.glb?level=2"
        return _tagged(request, text.replace("avatar.glb?level=2", wished).encode(), "text/html")

    return answer


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


def file_answer(
    path: Path, kind: str, headers: Mapping[str, str] | None = None
) -> Callable[[Request], Awaitable[Response]]:
    """An endpoint that sends a file, of the media type `kind`."""

    async def answer(_: Request) -> Response:
        return Response(await anyio.to_thread.run_sync(path.read_bytes), media_type=kind, headers=headers)

    return answer


async def _avatar(request: Request) -> Response:
    """A character's GLB: `?character=` chooses it; `?level=` 0 to 2 has less detail and needs a meshopt decoder."""
    name, level = request.query_params.get("character", CHARACTERS[0]), request.query_params.get("level", "")
    if name not in CHARACTERS:
        return PlainTextResponse(f"choose a character from {', '.join(CHARACTERS)}\n", 404, _SHARED)
    if level not in ("", *map(str, range(LEVELS))):
        return PlainTextResponse(f"choose a level of detail from 0 (finest) to {LEVELS - 1}\n", 404, _SHARED)
    data = await anyio.to_thread.run_sync(_character, name, level)
    return _tagged(request, data, "model/gltf-binary", _FOR_ALL, is_packed=True)


def _tagged(
    request: Request, data: bytes, kind: str, headers: Mapping[str, str] | None = None, *, is_packed: bool = False
) -> Response:
    """The data; 304 if the client has it already; gzipped if the client accepts that."""
    packed = data if is_packed else gzip.compress(data, 6, mtime=0)
    told = {**(headers or {}), "vary": "Accept-Encoding", "etag": f'"{sha256(packed).hexdigest()[:20]}"'}
    if told["etag"] in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=told)
    if "gzip" not in request.headers.get("accept-encoding", ""):
        return Response(gzip.decompress(packed), media_type=kind, headers=told)
    return Response(packed, media_type=kind, headers={**told, "content-encoding": "gzip"})


@lru_cache
def _character(name: str, level: str) -> bytes:
    """A character's GLB, gzipped: at a level of detail, or whole and plain, for every program."""
    if level:
        return gzip.compress(level_file(name, int(level)).read_bytes(), 9, mtime=0)
    return gzip.compress(pack_glb(load_character(name), []), 6, mtime=0)
