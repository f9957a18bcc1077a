"""The example pages in Chromium, with the packed tarball and node_modules in the place of their CDN."""

import base64
import functools
import http.server
import re
import shutil
import subprocess
import sys
import tarfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image
from tests.web.conftest import PageDriver, free_port, serving
from tests.web.mock_server import ready

from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import pack_glb
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.wire.codec import encode
from echoavatar.wire.messages import Motion, Ready

pytestmark = pytest.mark.browser
ROOT = Path(__file__).parents[2]
MODULES = ROOT / "web/node_modules"
CDN = "https://cdn.jsdelivr.net/npm/"
MODULE = re.compile(r"/cdn/((?:@[\w-]+/)?[\w.-]+)@[\w.]+/([^?]+)")
LIVEKIT = """
export * from "/cdn/livekit-client@2.23.0/dist/real.mjs";
import { Room as Real } from "/cdn/livekit-client@2.23.0/dist/real.mjs";
export class Room extends Real { constructor() { super(); globalThis.room = this; } }
"""
PIPECAT = """
export class PipecatClient {
  listeners = {};
  constructor() { globalThis.client = this; }
  on(event, listener) { this.listeners[event] = listener; }
  sendClientMessage(type) { globalThis.asked = type; }
}
"""
STAND_INS = {
    "livekit-client.esm.mjs": LIVEKIT,  # theirs, kept within reach
    "@pipecat-ai/client-js@": PIPECAT,
    "small-webrtc-transport@": "export class SmallWebRTCTransport {}",
}

# As motion comes: a message for every 267 ms of sound. The function that takes one follows.
PACED = """
(messages) => ((take) => {
  take(messages.shift());
  setInterval(() => messages.length && take(messages.shift()), 267);
})"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked tarball: what npm would install."""
    if shutil.which("npm") is None or not (MODULES / "three").exists():
        pytest.skip("needs npm and web/node_modules (make web)")
    folder = tmp_path_factory.mktemp("packed")
    client = ROOT / "web/packages/client"
    subprocess.run(["npm", "pack", "--pack-destination", folder], cwd=client, check=True, capture_output=True)
    with tarfile.open(next(folder.glob("*.tgz"))) as archive:
        archive.extractall(folder, filter="data")
    return folder / "package"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, package: Path) -> Iterator[str]:
    """The example pages with an avatar beside them, and at /cdn what their CDN has. Only the CDN's address is changed.

    A route of the driver would not do, because the scripts of worklets are not routed.
    """
    folder = tmp_path_factory.mktemp("site")
    for page in (ROOT / "docs/examples").glob("*.html"):
        (folder / page.name).write_text(page.read_text("utf-8").replace(CDN, "/cdn/"), "utf-8")
    (folder / "avatar.glb").write_bytes(pack_glb(load_character(), []))

    class Handler(http.server.SimpleHTTPRequestHandler):
        extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {".mjs": "text/javascript"}

        def translate_path(self, path: str) -> str:
            if not (found := MODULE.fullmatch(path)):
                return super().translate_path(path)
            name, rest = found.groups()
            home = package if name == "@echoavatar/client" else MODULES / name
            return str(home / rest.replace("real.mjs", "livekit-client.esm.mjs"))

        def do_GET(self) -> None:
            stood_in = next((text for end, text in STAND_INS.items() if end in self.path), None)
            if stood_in is None:
                super().do_GET()
                return
            self.send_response(200)
            self.send_header("content-type", "text/javascript")
            self.end_headers()
            self.wfile.write(stood_in.encode())

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


@pytest.fixture
def open_page(new_page: Callable[..., PageDriver], site: str) -> Callable[[str], PageDriver]:
    def open_(path: str) -> PageDriver:
        driver = new_page(640, 480)
        driver.page.goto(f"{site}/{path}", wait_until="commit", timeout=120_000)
        driver.wait("!!document.querySelector('#stage canvas')")
        return driver

    return open_


def messages() -> list[Ready | Motion]:
    """The rig, and eight seconds in which the avatar turns round and round, and walks a metre a second aside."""
    chunks = []
    for chunk in range(30):
        rotations = np.zeros((8, HUMANOID.joints, 4), np.int16)
        rotations[..., 3] = 32767
        half = (chunk * 8 + np.arange(8)) / 30
        rotations[:, 0, 1], rotations[:, 0, 3] = 32767 * np.sin(half), 32767 * np.cos(half)
        root = np.tile(np.array(HUMANOID.config.offsets[0], np.float32), (8, 1))
        root[:, 0] = half
        face = np.zeros((8, len(ARKIT_NAMES)), np.uint8)
        frames = {"rotations": rotations.tobytes(), "root": root.tobytes(), "face": face.tobytes()}
        chunks.append(Motion(at=chunk * 6400, frames=8, epoch=0, state="speaking", **frames))
    return [ready(), *chunks]


@pytest.fixture
def live_origin(site: str) -> Iterator[str]:
    """The real server, which lets the site's pages connect."""
    port = free_port()
    command = [sys.executable, "-m", "echoavatar", "serve", "--port", str(port), "--origin", site]
    for url in serving(command, port):
        yield url.rstrip("/")


def moves(driver: PageDriver, tmp_path: Path) -> None:
    """The picture changes much from one second to the next."""
    pictures = []
    for index in range(3):
        driver.shot(tmp_path / f"{index}.png")
        pictures.append(np.asarray(Image.open(tmp_path / f"{index}.png").convert("L"), float))
        driver.page.wait_for_timeout(700)
    assert max(np.abs(pictures[0] - later).mean() for later in pictures[1:]) > 0.3
    assert not [problem for problem in driver.problems if "favicon" not in problem and "404" not in problem]


def is_in_the_picture(driver: PageDriver, tmp_path: Path) -> bool:
    """Whether the avatar, darker than the page, stands in the middle half."""
    driver.shot(tmp_path / "where.png")
    picture = np.asarray(Image.open(tmp_path / "where.png").convert("L"), float)
    columns = np.flatnonzero((picture[: len(picture) // 2] < 160).sum(0) > 5)
    return len(columns) > 0 and picture.shape[1] / 4 < columns.mean() < picture.shape[1] * 3 / 4


def test_the_plain_page_speaks(open_page: Callable[[str], PageDriver], live_origin: str, tmp_path: Path) -> None:
    driver = open_page(f"page.html?server={live_origin}")
    driver.wait("!document.querySelector('#speak').disabled", 300)
    driver.click("#speak")
    driver.page.wait_for_timeout(3000)
    moves(driver, tmp_path)


def test_a_livekit_room_moves_the_avatar(open_page: Callable[[str], PageDriver], tmp_path: Path) -> None:
    driver = open_page("livekit.html")
    driver.wait("!!globalThis.room")
    driver.page.wait_for_timeout(300)
    topics = {Ready: "echoavatar", Motion: "echoavatar.motion"}
    packed = [[base64.b64encode(encode(message)).decode(), topics[type(message)]] for message in messages()]
    take = (
        "(([text, topic]) => { const payload = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));"
        " room.emit('dataReceived', payload, undefined, 0, topic); })"
    )
    driver.page.evaluate(PACED + take, packed)
    moves(driver, tmp_path)
    driver.page.wait_for_timeout(1500)
    assert is_in_the_picture(driver, tmp_path)


def test_rtvi_messages_move_the_avatar(open_page: Callable[[str], PageDriver], tmp_path: Path) -> None:
    driver = open_page("rtvi.html")
    driver.wait("!!globalThis.client && 'serverMessage' in client.listeners")
    driver.page.wait_for_timeout(300)
    driver.page.evaluate("() => client.listeners.botReady()")
    assert driver.ask("asked") == "echoavatar"
    sent = [{"type": "echoavatar", "message": msgspec.to_builtins(message)} for message in messages()]
    driver.page.evaluate(PACED + "((data) => client.listeners.serverMessage(data))", sent)
    moves(driver, tmp_path)
