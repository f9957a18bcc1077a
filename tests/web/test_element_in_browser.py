"""`<echo-avatar>` in pages of another origin than the server's, in Chromium and in Firefox."""

import io
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from PIL import Image
from tests.http_server import Handler, HttpServer
from tests.web.conftest import ROOT, PageDriver, free_port, serving
from tests.web.firefox import Firefox

pytestmark = pytest.mark.browser
FIRST = "document.querySelector('echo-avatar')"
MESSAGE = "document.querySelector('echo-avatar').shadowRoot.getElementById('message').textContent"
NOTE = """
<script>
window.told = [];
for (const name of ["ready", "state", "action", "error"])
  document.addEventListener(name, (event) => told.push([name, event.message ?? event.detail]), true);
</script>
"""
STRICT = (
    "default-src 'none'; script-src {server} 'wasm-unsafe-eval' 'unsafe-inline'; "
    "connect-src {server} {socket} blob:; img-src blob:"
)


def tone(seconds: float, rate: int = 24_000) -> bytes:
    """A WAV that the stand-in server takes for speech."""
    wav = io.BytesIO()
    soundfile.write(wav, 0.3 * np.sin(np.arange(round(seconds * rate)) * 0.1), rate, format="WAV")
    return wav.getvalue()


@pytest.fixture(scope="module")
def voiced_url() -> Iterator[str]:
    """The stand-in server with a voice, which is a service of this test: every text is a tone of a second."""

    def act(handler: Handler) -> None:
        wav = tone(1.0)
        handler.send_response(200)
        handler.send_header("content-length", str(len(wav)))
        handler.end_headers()
        handler.wfile.write(wav)

    service = HttpServer(act)
    threading.Thread(target=service.serve_forever, daemon=True).start()
    port = free_port()
    os.environ["ECHOAVATAR_VOICE_URL"] = f"{service.url}/v1"
    try:
        yield from serving([sys.executable, str(ROOT / "tests/web/mock_server.py"), "--port", str(port)], port)
    finally:
        del os.environ["ECHOAVATAR_VOICE_URL"]
        service.shutdown()


@pytest.fixture(scope="module")
def firefox() -> Iterator[Firefox]:
    browser = Firefox(free_port())
    yield browser
    browser.close()


@pytest.fixture(params=["chromium", "firefox"])
def new_tab(request: pytest.FixtureRequest) -> Iterator[Callable[..., PageDriver]]:
    """Opens a tab of either browser."""
    if request.param == "chromium":
        yield request.getfixturevalue("new_page")
        return
    firefox, pages = request.getfixturevalue("firefox"), []

    def make(width: int = 480, height: int = 360) -> PageDriver:
        pages.append(firefox.new_page(width, height))
        return PageDriver(pages[-1])

    yield make
    for page in pages:
        page.close()


class Site:
    """A site whose pages are what a test writes; each has the headers that go with it."""

    def __init__(self) -> None:
        self.pages: dict[str, tuple[str, Mapping[str, str]]] = {}
        self._server = HttpServer(self._answer)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.port = self._server.server_port

    def _answer(self, handler: Handler) -> None:
        text, headers = self.pages.get(handler.path.partition("?")[0], ("", {}))
        body = text.encode()
        handler.send_response(200 if text else 404)
        for name, value in {
            "content-type": "text/html; charset=utf-8",
            "content-length": str(len(body)),
            **headers,
        }.items():
            handler.send_header(name, value)
        handler.end_headers()
        handler.wfile.write(body)

    def page(self, body: str, host: str = "127.0.0.1", **headers: str) -> str:
        """The address of a page with this body."""
        path = f"/{len(self.pages)}.html"
        text = f"<!doctype html><meta charset='utf-8'><title>t</title><link rel='icon' href='data:,'>{NOTE}{body}"
        self.pages[path] = (text, {name.replace("_", "-"): value for name, value in headers.items()})
        return f"http://{host}:{self.port}{path}"

    def close(self) -> None:
        self._server.shutdown()


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    site = Site()
    yield site
    site.close()


def tag(server: str, attributes: str = "") -> str:
    """The one tag of script, and an element."""
    return f"<script type=module src='{server}client/echo-avatar.js'></script><echo-avatar {attributes}></echo-avatar>"


def moved(driver: PageDriver, tmp_path: Path) -> float:
    """The mean change of the picture over a second, of 255."""
    pictures = []
    for index in range(3):
        driver.shot(tmp_path / f"{index}.png")
        pictures.append(np.asarray(Image.open(tmp_path / f"{index}.png").convert("L"), float))
        driver.page.wait_for_timeout(500)
    return max(float(np.abs(pictures[0] - later).mean()) for later in pictures[1:])


def events(driver: PageDriver, name: str) -> list[Any]:
    return [detail for kind, detail in driver.ask("told") if kind == name]


def test_one_tag_shows_a_moving_avatar(
    new_tab: Callable[..., PageDriver], voiced_url: str, site: Site, tmp_path: Path
) -> None:
    driver = new_tab()
    driver.page.goto(site.page(tag(voiced_url, "muted")))
    driver.wait(f"!!({FIRST}.stage?.avatar && {FIRST}.session?.ready)")
    driver.page.wait_for_timeout(1500)
    assert moved(driver, tmp_path) > 0.1
    assert events(driver, "ready")[0]["rig"]["names"][0] == "hips"
    assert driver.problems == []
