"""The example pages in Chromium, as written: their client is the running server's. Then with the packed tarball."""

import base64
import functools
import http.server
import os
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
SERVER = "http://127.0.0.1:8765"  # in the examples
PACKED = """
  "@echoavatar/client": "/cdn/@echoavatar/client@0/dist/index.js",
  "@echoavatar/client/livekit": "/cdn/@echoavatar/client@0/dist/livekit.js",
  "@echoavatar/client/rtvi": "/cdn/@echoavatar/client@0/dist/rtvi.js",
  "@echoavatar/client/three": "/cdn/@echoavatar/client@0/dist/drivers/index.js",
  "@msgpack/msgpack": "/cdn/@msgpack/msgpack@3/dist.esm/index.mjs",
  "@pixiv/three-vrm": "/cdn/@pixiv/three-vrm@3/lib/three-vrm.module.js",
  "three": "/cdn/three@0/build/three.module.js",
  "three/": "/cdn/three@0/" }"""
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
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What lies there is a page of the site."""
    return tmp_path_factory.mktemp("site")


@pytest.fixture(scope="module")
def site(pages: Path, package: Path, server: str) -> Iterator[str]:
    """The example pages with an avatar beside them; at /cdn what a CDN has; in /packed the pages with the tarball.

    A route of the driver would not do: scripts of worklets are not routed, and to Chromium a routed page is one of the
    internet, which may not reach this machine.
    """
    (pages / "packed").mkdir()
    for page in (ROOT / "docs/examples").glob("*.html"):
        text = page.read_text("utf-8").replace(CDN, "/cdn/")
        (pages / page.name).write_text(text.replace(SERVER, server), "utf-8")
        packed = re.sub(r'"@echoavatar/client.*?" \}', PACKED, text, count=1, flags=re.DOTALL)
        assert packed != text
        (pages / "packed" / page.name).write_text(packed, "utf-8")
    (pages / "avatar.glb").write_bytes(pack_glb(load_character(), []))
    shutil.copy(pages / "avatar.glb", pages / "packed")

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

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(pages)))
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


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """The real server; pages of this machine may connect."""
    port = free_port()
    for url in serving([sys.executable, "-m", "echoavatar", "serve", "--port", str(port)], port):
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


@pytest.mark.parametrize("folder", ["", "packed/"])
def test_the_plain_page_speaks(
    open_page: Callable[[str], PageDriver], server: str, folder: str, tmp_path: Path
) -> None:
    driver = open_page(f"{folder}page.html?server={server}")
    driver.wait("!document.querySelector('#speak').disabled", 300)
    driver.click("#speak")
    driver.page.wait_for_timeout(3000)
    moves(driver, tmp_path)


@pytest.mark.parametrize("folder", ["", "packed/"])
def test_a_livekit_room_moves_the_avatar(open_page: Callable[[str], PageDriver], folder: str, tmp_path: Path) -> None:
    driver = open_page(f"{folder}livekit.html")
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


@pytest.mark.parametrize("folder", ["", "packed/"])
def test_rtvi_messages_move_the_avatar(open_page: Callable[[str], PageDriver], folder: str, tmp_path: Path) -> None:
    driver = open_page(f"{folder}rtvi.html")
    driver.wait("!!globalThis.client && 'serverMessage' in client.listeners")
    driver.page.wait_for_timeout(300)
    driver.page.evaluate("() => client.listeners.botReady()")
    assert driver.ask("asked") == "echoavatar"
    sent = [{"type": "echoavatar", "message": msgspec.to_builtins(message)} for message in messages()]
    driver.page.evaluate(PACED + "((data) => client.listeners.serverMessage(data))", sent)
    moves(driver, tmp_path)


APP = """
import { createElement as h, useState } from "react";
import { createRoot } from "react-dom/client";
import { EchoAvatar } from "@echoavatar/client/react";
import { EchoAvatarElement } from "@echoavatar/client/element";

function App() {
  const [view, setView] = useState("full");
  const [shown, show] = useState(true);
  Object.assign(window, { setView, show });
  const note = (name) => (event) => told.push([name, view, event.type]);
  return shown && h(EchoAvatar, {
    server: new URLSearchParams(location.search).get("server"), view, muted: true, className: "mine",
    ref: (element) => (window.element = element),
    onReady: note("ready"), onState: note("state"), onError: note("error"),
  });
}
window.told = [];
window.isElement = () => element instanceof EchoAvatarElement;
createRoot(document.getElementById("stage")).render(h(App));
"""


def test_the_react_wrapper_passes_props_and_events_on(
    package: Path, pages: Path, new_page: Callable[..., PageDriver], server: str, site: str, tmp_path: Path
) -> None:
    """Bundled from the tarball as an application would."""
    (tmp_path / "app.js").write_text(APP)
    (tmp_path / "node_modules/@echoavatar").mkdir(parents=True)
    (tmp_path / "node_modules/@echoavatar/client").symlink_to(package)
    words = [MODULES / ".bin/esbuild", "app.js", "--bundle", "--format=esm", "--preserve-symlinks"]
    bundled = subprocess.run(
        words, cwd=tmp_path, env={**os.environ, "NODE_PATH": str(MODULES)}, capture_output=True, text=True
    )
    assert bundled.returncode == 0, bundled.stderr
    body = "<link rel=icon href=data:,><div id=stage></div><script type=module src=react.js></script>"
    (pages / "react.html").write_text(body)
    (pages / "react.js").write_text(bundled.stdout)
    driver = new_page(640, 480)
    driver.page.goto(f"{site}/react.html?server={server}")
    driver.wait("window.told?.some(([name]) => name === 'ready')", 120)
    assert driver.ask("[isElement(), element.className, element.muted, element.view]") == [True, "mine", True, "full"]
    driver.page.evaluate("setView('face')")
    driver.wait("element.view === 'face' && element.stage.view === 'face'")
    driver.page.evaluate(f"void element.send('{server}/sounds/speech.ogg')")
    driver.wait("told.some(([name, view]) => name === 'state' && view === 'face')", 120)
    driver.page.evaluate("(() => { window.session = element.session; show(false); })()")
    driver.wait("session.connection.over && window.element === null")
    assert driver.problems == []
