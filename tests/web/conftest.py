"""A browser, a stand-in server and a real one, for the tests of the live page."""

import base64
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from tests.web.firefox import Firefox, FirefoxPage
from tests.web.mock_server import make_app

ROOT = Path(__file__).parents[2]
START_S = 300  # the first start on a machine compiles kernels, and the machine may be busy
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--use-fake-ui-for-media-stream",
    "--use-fake-device-for-media-stream",
)
LEAVING = ("context was destroyed", "no such frame", "AbortError", "unable to find the window")  # as browsers say it
DROP = """
(files) => {
  const dataTransfer = new DataTransfer();
  for (const [name, base64, type] of files) {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    dataTransfer.items.add(new File([bytes], name, { type }));
  }
  for (const kind of ["dragenter", "dragover", "drop"])
    window.dispatchEvent(new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
}
"""


class PageDriver:
    """One tab and its console messages. Conditions are polled, because the page forbids `eval`."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.problems: list[str] = []
        page.on("console", self._note)
        page.on("pageerror", lambda error: self.problems.append(f"error: {error}"))

    def need_sound(self) -> None:
        """Skip where nothing can be heard: Firefox needs a sound device for that, Chromium brings a false one."""
        if isinstance(self.page, FirefoxPage) and not self.page.has_sound:
            pytest.skip("no sound device for Firefox on this machine: apt-get install pulseaudio")

    def _note(self, message: Any) -> None:
        if message.type == "error" or (message.type == "warning" and "GPU stall" not in message.text):
            self.problems.append(f"{message.type}: {message.text}")

    def open(self, url: str) -> None:
        self.page.goto(url, wait_until="commit", timeout=120_000)
        self.wait("!!(window.__echo && __echo.avatar.driver && __echo.metrics && __echo.shown)")

    def ask(self, expression: str) -> Any:
        return json.loads(self.page.evaluate(f"JSON.stringify({expression})") or "null")

    def wait(self, condition: str, seconds: float = 60) -> None:
        end = time.monotonic() + seconds
        while not self._is(condition):
            assert time.monotonic() < end, f"{condition} did not become true; console: {self.problems}"
            time.sleep(0.1)

    def _is(self, condition: str) -> bool:
        """Whether it holds; not while the page is left for the next."""
        try:
            return bool(self.page.evaluate(condition))
        except Exception as error:
            if any(told in str(error) for told in LEAVING):
                return False
            raise

    def click(self, selector: str) -> None:
        """Click what is there or soon will be, without waiting for animations to finish."""
        found = f"document.querySelector({json.dumps(selector)})"
        self.wait(f"!!{found}")
        self.page.evaluate(
            f"void {found}.dispatchEvent(new MouseEvent('click', {{ bubbles: true, cancelable: true }}))"
        )

    def follow(self, selector: str) -> None:
        """Click what leads to another page, and wait for that."""
        self.page.evaluate("void (window.isOld = true)")
        self.click(selector)
        self.wait("!window.isOld && document.readyState === 'complete'")

    def write(self, selector: str, text: str, *, end: str = "Enter") -> None:
        """Type into a field, and press a last key."""
        found = f"document.querySelector({json.dumps(selector)})"
        self.page.evaluate(f"void ({found}.focus(), {found}.select())")
        self.page.keyboard.type(text)
        if end:
            self.page.keyboard.press(end)

    def download(self, selector: str, folder: Path) -> Path:
        """Click what gives a file, and put that into a folder under the name that the page gave it."""
        if isinstance(self.page, FirefoxPage):
            return self.page.download(lambda: self.click(selector), folder)
        with self.page.expect_download() as waiting:
            self.click(selector)
        waiting.value.save_as(folder / waiting.value.suggested_filename)
        return folder / str(waiting.value.suggested_filename)

    def drop(self, name: str, data: bytes, kind: str = "model/gltf-binary") -> None:
        """Drop a file on the page."""
        self.drop_all({name: data}, kind)

    def drop_all(self, files: Mapping[str, bytes], kind: str = "") -> None:
        """Drop several files together."""
        self.page.evaluate(DROP, [[name, base64.b64encode(data).decode(), kind] for name, data in files.items()])

    def shot(self, path: Path) -> None:
        self.page.screenshot(path=path, timeout=120_000)


@pytest.fixture(scope="module")  # its event loop must be gone when another module runs one
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture
def new_page(browser: Any) -> Iterator[Callable[..., PageDriver]]:
    contexts = []

    def make(width: int = 320, height: int = 240, **options: Any) -> PageDriver:
        contexts.append(browser.new_context(viewport={"width": width, "height": height}, **options))
        return PageDriver(contexts[-1].new_page())

    yield make
    for context in contexts:
        context.close()


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
    firefox, pages = request.getfixturevalue("firefox"), list[FirefoxPage]()

    def make(width: int = 480, height: int = 360) -> PageDriver:
        pages.append(firefox.new_page(width, height))
        return PageDriver(pages[-1])

    yield make
    for page in pages:
        page.close()


@pytest.fixture(scope="module")
def mock_url() -> Iterator[str]:
    """A mock server without models, whose pose and sound encode its clock."""
    port = free_port()
    script = Path(__file__).with_name("mock_server.py")
    yield from serving([sys.executable, str(script), "--port", str(port), "--tell-clock"], port)


@contextmanager
def mocked(**changes: Any) -> Iterator[str]:
    """The mock server in a thread of this process, with a stream or routes of the test's own (`make_app`)."""
    app = make_app({}, tell_clock=False, **changes)
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_level="warning", lifespan="off"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.05)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}/"
    finally:
        server.should_exit = server.force_exit = True
        thread.join(20)


@pytest.fixture(scope="module")
def live_url() -> Iterator[str]:
    """The real server with the default bundle."""
    port = free_port()
    yield from serving([sys.executable, "-m", "echoavatar", "serve", "--port", str(port), "--seats", "2"], port)


def serving(command: list[str], port: int) -> Iterator[str]:
    url = f"http://127.0.0.1:{port}/"
    process = subprocess.Popen(command, cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"})
    try:
        end = time.monotonic() + START_S
        while not _answers(url):
            assert process.poll() is None, f"{command} ended with {process.returncode}"
            assert time.monotonic() < end, f"{command} does not answer"
            time.sleep(0.3)
        yield url
    finally:
        process.kill()
        process.wait()


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2) as answer:
            return answer.status == 200
    except OSError:
        return False


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
