"""The studio's pages, the character that they show, and its rig. Pages load nothing from other servers."""

import logging
import re
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import pack_glb
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import FRAME_RATE_HZ

from .errors import not_found
from .http import refused, reply
from .settings import LANGUAGE
from .wire_rater import RigInfo, Scene

_LOG = logging.getLogger(__name__)
STATIC = Path(__file__).parent / "static"
_HEADERS = {
    # WebAssembly decodes the avatar's mesh.
    "content-security-policy": "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; media-src 'self' blob:; "
    "connect-src 'self' blob: data:; "
    "worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "cache-control": "no-cache",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
}
_PLAIN = """<!doctype html><html lang="en"><title>EchoAvatar studio</title>
<h1>The studio is running</h1>
<p>Its pages are not built into this installation; the API is at <code>/api</code> (docs/studio.md).</p></html>
"""


def page_routes(static: Path = STATIC, *, words: Path | None = None) -> list[BaseRoute]:
    """Routes of pages and their shared files. They match every address, so they must come last.

    `words` is the folder of the owner's translations, with a file such as `de.json` or `pt-BR.json` for each language.
    """
    languages = [folder for folder in (words, static / "words") if folder is not None]

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
        Route("/words/{language}.json", partial(_words, languages)),
        page("index"),
        page("rate"),
    ]
    if (static / "assets").is_dir():
        # The installed avatar has three.js, for its own pages too.
        built = StaticFiles(directory=static / "assets", packages=[("echoavatar", "assets/shared")])
        routes.append(Mount("/assets", built))
    return routes


async def _words(folders: Sequence[Path], request: Request) -> Response:
    found = await anyio.to_thread.run_sync(read_words, folders, request.path_params["language"])
    if found is None:
        return refused(not_found())
    return Response(msgspec.json.encode(found), media_type="application/json", headers={"cache-control": "no-cache"})


def read_words(folders: Sequence[Path], language: str) -> dict[str, str] | None:
    """The words of a language from the first folder that has them, or None.

    An invalid file is skipped with a line in the log; raters then read English.
    """
    if not re.fullmatch(LANGUAGE, language):
        return None
    for path in (folder / f"{language}.json" for folder in folders):
        try:
            return msgspec.json.decode(path.read_bytes(), type=dict[str, str])
        except FileNotFoundError:
            continue
        except (OSError, msgspec.MsgspecError) as error:
            _LOG.warning("%s holds no words: %s", path, error)
    return None


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
