"""`<echo-avatar>` in pages of another origin than the server's, in Chromium and in Firefox."""

import base64
import io
import os
import re
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

pytestmark = pytest.mark.browser
FIRST = "document.querySelector('echo-avatar')"
MESSAGE = "document.querySelector('echo-avatar').shadowRoot.getElementById('message').textContent"
NOTE = """
<script>
window.told = [];
for (const name of ["ready", "state", "action", "error"])
  document.addEventListener(name, (event) => {
    if (event.target.tagName === "ECHO-AVATAR") told.push([name, event.message ?? event.detail]);
  }, true);
</script>
"""


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


def test_it_speaks_and_takes_sound_and_says_what_it_does(
    new_tab: Callable[..., PageDriver], voiced_url: str, site: Site
) -> None:
    driver = new_tab()
    driver.page.goto(site.page(tag(voiced_url, "muted view='bust' character='theo' light='dusk'")))
    driver.wait(f"!!{FIRST}.session?.ready")
    driver.page.evaluate(f"void {FIRST}.speak('Hello there.').then((heard) => (window.heard = heard))")
    driver.wait("window.heard === true")
    driver.wait("told.some(([name, detail]) => name === 'state' && detail === 'idle')")
    assert events(driver, "state")[:2] == ["speaking", "idle"]
    samples = "new Float32Array(16000).map((_, i) => Math.sin(i / 8) / 3)"
    wav = f"Uint8Array.from(atob('{base64.b64encode(tone(0.5)).decode()}'), (letter) => letter.charCodeAt(0))"
    for sound in (
        f"{samples}, {{ rate: 16000 }}",
        f"{wav}.buffer",
        f"new Blob([{wav}])",
        f"'{voiced_url}sounds/speech.ogg'",
    ):
        driver.page.evaluate(
            f"window.sent = undefined; void {FIRST}.send({sound}).then((heard) => (window.sent = heard))"
        )
        driver.wait(f"{FIRST}.state === 'speaking'")
        if "ogg" in sound:
            driver.page.evaluate(f"{FIRST}.interrupt()")
        driver.wait(f"window.sent === {'false' if 'ogg' in sound else 'true'}")
        driver.wait(f"{FIRST}.state === 'idle'")
    driver.page.evaluate(f"{FIRST}.act('wave')")
    driver.wait("told.some(([name, detail]) => name === 'action' && detail.status === 'started')")
    assert events(driver, "error") == driver.problems == []


def test_streams_are_said_as_they_come_and_lines_wait_for_each_other(
    new_tab: Callable[..., PageDriver], voiced_url: str, site: Site
) -> None:
    driver = new_tab()
    driver.page.goto(site.page(tag(voiced_url, "muted")))
    driver.wait(f"!!{FIRST}.session?.ready")
    driver.page.evaluate(
        f"""(() => {{
          const block = () => new Float32Array(12000).map((_, i) => Math.sin(i / 8) / 3);
          const pause = () => new Promise((done) => setTimeout(done, 300));
          const stream = async function* () {{ for (let k = 0; k < 4; k++) {{ yield block(); await pause(); }} }};
          window.order = [];
          void {FIRST}.send(stream()).then((heard) => order.push(["stream", heard]));
          void {FIRST}.speak("Then this.").then((heard) => order.push(["text", heard]));
        }})()"""
    )
    driver.wait("window.order.length === 2")
    assert driver.ask("order") == [["stream", True], ["text", True]]
    driver.page.evaluate(
        f"""(() => {{
          const context = new AudioContext();
          const source = new OscillatorNode(context);
          const out = context.createMediaStreamDestination();
          source.connect(out); source.start();
          window.live = out.stream;
          void {FIRST}.send(out.stream).then((heard) => (window.live = heard));
        }})()"""
    )
    driver.page.wait_for_timeout(500)
    assert driver.ask("live instanceof MediaStream")
    driver.page.evaluate(f"{FIRST}.interrupt()")
    driver.wait("window.live === false")


def test_several_live_in_a_page_and_one_that_is_taken_out_leaves_nothing(
    new_tab: Callable[..., PageDriver], voiced_url: str, site: Site
) -> None:
    driver = new_tab()
    extra = "<echo-avatar id=b muted></echo-avatar><div id=shelf></div><echo-avatar id=c muted></echo-avatar>"
    driver.page.goto(site.page(tag(voiced_url, "id=a muted") + extra))
    ready = "[...document.querySelectorAll('echo-avatar')].every((one) => one.session?.ready && one.stage?.avatar)"
    driver.wait(ready)
    driver.page.evaluate(
        "window.kept = [a.session, b.session, c.session, c.stage.renderer.getContext()].slice(); void 0"
    )
    driver.page.evaluate("shelf.append(b); c.remove(); void 0")
    driver.wait("kept[3].isContextLost()")
    assert driver.ask("[a.session === kept[0], b.session === kept[1], kept[2].connection.over]") == [True, True, True]
    driver.page.evaluate("kept[0].ready && (window.at = b.session.player.heard)")
    driver.wait("b.session.player.heard > at + 6000")
    driver.page.evaluate(
        "for (let k = 0; k < 24; k++) { document.body.append(document.createElement('echo-avatar'));"
        " document.body.lastChild.remove(); }"
    )
    driver.page.evaluate("{ const one = b; one.remove(); document.body.append(one); }")
    driver.wait("b.session === kept[1]")
    assert [
        told for told in driver.problems if not re.search("context.*lost", told, re.I)
    ] == []  # that of `c`, on purpose


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ("server='http://127.0.0.1:9/'", "does not answer"),
        ("server='ftp://x'", "not the address of a server"),
        ("mode='sideways'", "none of free, in-place, upper-body"),
        ("character='nobody'", "choose a character from maya"),
        ("character='./nothing.vrm'", "answered 404"),
    ],
)
def test_what_is_wrong_is_said_in_the_page_and_to_it(
    new_tab: Callable[..., PageDriver], voiced_url: str, site: Site, attributes: str, said: str
) -> None:
    driver = new_tab()
    driver.page.goto(site.page(tag(voiced_url, f"muted {attributes}")))
    driver.wait(f"{MESSAGE}.includes('{said}')")
    assert any(said in message for message in events(driver, "error"))
    driver.page.evaluate(f"for (const name of ['server', 'mode', 'character']) {FIRST}.removeAttribute(name)")
    driver.wait(f"!!({FIRST}.session?.ready && {FIRST}.stage.avatar)")


def test_a_page_with_a_strict_policy_needs_what_the_docs_say(
    new_tab: Callable[..., PageDriver], voiced_url: str, site: Site, tmp_path: Path
) -> None:
    server = voiced_url.rstrip("/")
    told = (ROOT / "docs/integrations/clients.md").read_text("utf-8")
    policy = re.findall(r"Content-Security-Policy: (.+)", told)[0]
    for written, here in {
        "https://avatar.example.org": server,
        "wss://avatar.example.org": server.replace("http", "ws"),
        "'self'": "'unsafe-inline'",  # the script of this test is in the page
        "img-src": "img-src data:",  # so is its icon
    }.items():
        policy = policy.replace(written, here)
    driver = new_tab()
    driver.page.goto(site.page(tag(voiced_url), content_security_policy=f"default-src 'none'; {policy}"))
    driver.wait(f"!!({FIRST}.session?.ready && {FIRST}.stage?.avatar)")
    driver.click("echo-avatar")  # a script event with a user's activation, as in the other tests
    driver.wait(f"{FIRST}.output !== null")  # it runs where there is a device for sound
    worklets = f"['playback', 'capture'].map((name) => {FIRST}.worklet(name))"
    loads = f"(async (context) => {{ for (const name of {worklets}) await context.audioWorklet.addModule(name); }})"
    assert driver.page.evaluate(f"{loads}(new OfflineAudioContext(1, 1, 24000)).then(() => true)")
    assert driver.problems == []


@pytest.fixture(scope="module")
def live_url(site: Site) -> Iterator[str]:
    """The real server, which lets pages of one name connect. Browsers take every NAME.localhost for this machine."""
    port = free_port()
    command = [sys.executable, "-m", "echoavatar", "serve", "--port", str(port), "--seats", "1"]
    yield from serving([*command, "--origin", f"http://friend.localhost:{site.port}"], port)


def test_pages_of_other_sites_must_be_allowed(new_tab: Callable[..., PageDriver], live_url: str, site: Site) -> None:
    driver = new_tab()
    driver.page.goto(site.page(tag(live_url, "muted"), host="stranger.localhost"))
    driver.wait(f"{MESSAGE}.includes('start with --origin http://stranger.localhost')")
    driver.page.goto(site.page(tag(live_url, "muted"), host="friend.localhost"))
    driver.wait(f"!!{FIRST}.session?.ready", 120)
    driver.page.evaluate(f"void {FIRST}.send('{live_url}sounds/speech.ogg')")
    driver.wait(f"{FIRST}.state === 'speaking'", 120)
    asked = "{ method: 'POST', headers: { 'content-type': 'application/json' }, body: '{}' }"
    answered = driver.page.evaluate(f"fetch('{live_url}v1/voice', {asked}).then((answer) => answer.status)")
    assert answered in (400, 404)  # read by the page: it gives no text, or there is no voice
    waiting = "<echo-avatar id=second muted></echo-avatar>"
    driver.page.evaluate(f"void document.body.insertAdjacentHTML('beforeend', '{waiting}')")
    driver.wait(
        "second.shadowRoot.getElementById('message').textContent.includes('All places are taken. You are next')"
    )
    driver.page.evaluate(f"{FIRST}.remove()")
    driver.wait("!!second.session?.ready", 120)
