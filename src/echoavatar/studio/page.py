"""The studio's pages, the character they show, and what every clip moves. Everything comes from this server."""

from functools import lru_cache
from pathlib import Path

import anyio.to_thread
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from ..avatar import load_character
from ..avatar.gltf import pack_glb
from ..face import ARKIT_NAMES
from ..kinematics import HUMANOID
from ..timing import FRAME_RATE_HZ
from .http import reply
from .wire_rater import RigInfo, Scene

STATIC = Path(__file__).parent / "static"
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; media-src 'self' blob:; connect-src 'self' blob: data:; "
    "worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "cache-control": "no-cache",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}
_PLAIN = """<!doctype html><html lang="en"><title>EchoAvatar studio</title>
<h1>The studio is running</h1>
<p>Its pages are not built into this installation; the API is at <code>/api</code> (docs/studio.md).</p></html>
"""


def page_routes(static: Path = STATIC) -> list[BaseRoute]:
    """Routes of pages and what all of them share; they catch every address, so they come last."""

    def page(name: str) -> Route:
        async def answer(_: Request) -> Response:
            path = static / f"{name}.html"
            if not await anyio.to_thread.run_sync(path.is_file):
                return HTMLResponse(_PLAIN, headers=_HEADERS)
            return FileResponse(path, headers=_HEADERS)

        return Route("/" if name == "index" else f"/{name}", answer)

    routes: list[BaseRoute] = [
        Route("/api/scene", _scene),
        Route("/avatar.glb", _avatar),
        page("index"),
        page("rate"),
    ]
    if (static / "assets").is_dir():
        routes.append(Mount("/assets", StaticFiles(directory=static / "assets")))
    return routes


async def _scene(_: Request) -> Response:
    answer = reply(scene())
    answer.headers["cache-control"] = "max-age=3600"
    return answer


@lru_cache(maxsize=1)
def scene() -> Scene:
    """The rig of the character, for `AvatarDriver.bind`."""
    rig = RigInfo(
        names=tuple(HUMANOID.names),
        parents=tuple(HUMANOID.parents),
        rest=tuple((float(x), float(y), float(z)) for x, y, z in HUMANOID.config.offsets),
    )
    return Scene(rig=rig, face=tuple(ARKIT_NAMES), frame_rate=FRAME_RATE_HZ, avatar="/avatar.glb")


async def _avatar(_: Request) -> Response:
    data = await anyio.to_thread.run_sync(_character)
    return Response(data, media_type="model/gltf-binary", headers={"cache-control": "max-age=3600"})


@lru_cache(maxsize=1)
def _character() -> bytes:
    return pack_glb(load_character(), [])
