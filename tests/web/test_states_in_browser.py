"""What the page shows before, between and beside motion: rest, the queue, panels, choices, in a real browser."""

import asyncio
import threading
import time

import pytest
from anyio import to_thread
from starlette.routing import Route
from tests.web.conftest import mocked
from tests.web.firefox import FirefoxPage
from tests.web.make_vrm import make_vrm
from tests.web.mock_server import MockSession, greeted, ready, refused

from echoavatar.server.page import page_routes
from echoavatar.wire.codec import decode_client, encode
from echoavatar.wire.messages import Error, Manner

pytestmark = pytest.mark.browser
SUBTITLE = "document.getElementById('subtitle').textContent"


@pytest.fixture
def page(new_tab, mock_url):
    driver = new_tab(480, 360)
    driver.open(f"{mock_url}?quality=low")
    yield driver
    assert driver.problems == []


# Metres of the left hand's height below the left shoulder's, and the chest's rotation.
HANGING = """(() => {
  const node = (name) => __echo.avatar.driver.object.getObjectByName(name);
  const height = (name) => node(name).getWorldPosition(__echo.avatar.here.clone()).y;
  return [height("leftUpperArm") - height("leftHand"), node("chest").quaternion.x];
})()"""


# CSS pixels of the head's joint.
HEAD = """(() => {
  __echo.viewport.camera.updateMatrixWorld();
  const { x, y } = __echo.avatar.head.project(__echo.viewport.camera);
  return [((x + 1) / 2) * innerWidth, ((1 - y) / 2) * innerHeight];
})()"""


# CSS pixels from the left of the middle of the rings.
RINGS_X = """(() => {
  const { camera, echoes } = __echo.viewport;
  camera.updateMatrixWorld();
  return ((echoes.mesh.position.clone().project(camera).x + 1) / 2) * innerWidth;
})()"""


def test_before_any_motion_a_person_rests_and_breathes(new_tab, tmp_path):
    async def stream(socket):
        await greeted(socket)
        await asyncio.sleep(600)

    driver = new_tab(480, 360)
    with mocked(stream=stream) as url:
        driver.page.goto(f"{url}?quality=low", wait_until="commit")
        driver.wait("!!(window.__echo && __echo.avatar.driver)")
        driver.wait("document.getElementById('silhouette').classList.contains('gone')")
        driver.wait(f"{HANGING}[0] > 0.35")
        chest = driver.ask(HANGING)[1]
        driver.wait(f"Math.abs({HANGING}[1] - {chest}) > 0.003")
        driver.shot(tmp_path / "rest.png")
        assert driver.ask("__echo.shown") is None
        assert driver.problems == []


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 800)])
def test_the_shadow_before_the_avatar_stands_where_it_will_and_under_no_panel(new_tab, width, height, tmp_path):
    come = threading.Event()
    avatar = next(route for route in page_routes() if route.path == "/avatar.glb")

    async def late(request):
        await to_thread.run_sync(come.wait, 60)
        return await avatar.endpoint(request)

    driver = new_tab(width, height)
    with mocked(routes=[Route("/avatar.glb", late)]) as url:
        driver.page.goto(f"{url}?quality=low", wait_until="commit")
        driver.wait("!!window.__echo && __echo.shown !== null")
        driver.wait("!!document.querySelector('.actions .chip')")  # the panel takes some of the place
        opacity = "Number(getComputedStyle(document.getElementById('silhouette')).opacity)"
        assert driver.ask(opacity) > 0.1
        driver.shot(tmp_path / "shadow.png")
        shadow, welcome = (
            driver.ask(f"document.getElementById('{name}').getBoundingClientRect()")
            for name in ("silhouette", "welcome")
        )
        assert welcome["right"] < shadow["left"] or shadow["bottom"] < welcome["top"]
        driver.wait(f"Math.abs({RINGS_X} - {(shadow['left'] + shadow['right']) / 2}) < {0.03 * width}")
        come.set()
        driver.wait(f"!!__echo.avatar.driver && !__echo.viewport.isGliding && {opacity} < 0.01")
        time.sleep(1)
        x, y = driver.ask(HEAD)
        assert abs(x - (shadow["left"] + shadow["right"]) / 2) < 0.03 * width
        assert abs(y - shadow["top"]) < 0.1 * height


def test_before_a_full_server_the_place_in_the_queue_is_told(new_tab, tmp_path):
    places, tickets = [3, 1], []

    async def stream(socket):
        tickets.append((await greeted(socket)).ticket)
        if not places:
            return await MockSession(socket).run()
        error = Error(code="overloaded", message="full", fatal=True, retry_after=1.5, place=places.pop(0))
        return await refused(socket, error, 4429)

    driver = new_tab(480, 360)
    with mocked(stream=stream) as url:
        driver.page.goto(f"{url}?quality=low", wait_until="commit")
        driver.wait(f"!!window.__echo && {SUBTITLE} === 'All places are taken. You are number 3 in the queue.'")
        driver.wait("!!__echo.avatar.driver")
        driver.wait(f"{HANGING}[0] > 0.35")
        told = "document.getElementById('subtitle')"
        assert driver.ask(f"{told}.scrollWidth <= {told}.clientWidth + 1")
        driver.wait(f"{UNDER}.length === 0")
        driver.shot(tmp_path / "queue.png")
        driver.wait(f"{SUBTITLE} === 'All places are taken. You are next.'")
        driver.wait("!!__echo.shown && document.getElementById('subtitle').classList.contains('off')")
        assert len(tickets) == 3
        assert len(set(tickets)) == 1
        assert driver.problems == []


def test_after_a_broken_line_a_person_rests_and_is_not_said_to_speak(new_tab, tmp_path):
    clients = []

    async def stream(socket):
        clients.append(await greeted(socket))
        await (MockSession(socket).run() if len(clients) == 1 else asyncio.sleep(600))

    driver = new_tab(480, 360)
    with mocked(stream=stream) as url:
        driver.open(f"{url}?quality=low")
        driver.click("[data-source=speech]")
        driver.wait(f"{SUBTITLE} === 'Speaking'")
        driver.page.evaluate("__echo.session.connection.socket.close()")
        driver.wait("document.getElementById('subtitle').classList.contains('off')")
        driver.wait("__echo.avatar.posture.share === 1")
        driver.wait(f"{HANGING}[0] > 0.35")
        driver.shot(tmp_path / "lost.png")
        assert driver.ask("document.getElementById('line').textContent") == "connecting"
        assert driver.problems == []


def test_the_headline_gives_way_to_a_panel(page):
    seen = "document.querySelector('.welcome h2').checkVisibility({ visibilityProperty: true })"
    for is_seen in (False, True):
        page.click("#meters")
        page.wait(f"{seen} === {str(is_seen).lower()}")


def test_who_has_come_to_stand_has_the_rings_around_her(page):
    page.page.evaluate("__echo.viewport.echoes.mesh.position.x += 1")
    page.wait("Math.abs(__echo.viewport.echoes.mesh.position.x - __echo.avatar.here.x) < 0.1")


# The hands and the head that are under a panel, each by the panel's name.
UNDER = """(() => {
  const { viewport, avatar } = __echo;
  viewport.camera.updateMatrixWorld();
  const found = [];
  for (const node of avatar.ends) {
    const { x, y } = node.getWorldPosition(avatar.here.clone()).project(viewport.camera);
    const [left, top] = [((x + 1) / 2) * innerWidth, ((1 - y) / 2) * innerHeight];
    const panels = "#hud, #talk, #menu, #actions, .dock, .welcome:not(.gone), #subtitle:not(.off), .toast";
    for (const box of document.querySelectorAll(panels)) {
      const at = box.getBoundingClientRect();
      if (!box.checkVisibility({ visibilityProperty: true })) continue;
      const isUnder = left > at.left && left < at.right && top > at.top && top < at.bottom;
      if (isUnder) found.push(`${node.name} ${box.id || box.className}`);
    }
  }
  return found;
})()"""
PRESSED = "document.querySelectorAll('[aria-expanded=true]').length"
OPEN = "['hud', 'talk', 'typed'].filter((name) => !document.getElementById(name).hidden)"


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1440, 900), (1000, 700)])
def test_one_panel_is_open_and_none_is_over_hands_or_face(new_tab, mock_url, width, height, tmp_path):
    driver = new_tab(width, height)
    driver.open(f"{mock_url}?quality=low")
    driver.wait("!document.querySelector('[data-source=chat]').hidden")
    steps = {"": [], "#look": [], "#begin": [], "#meters": ["hud"], "[data-source=chat]": ["talk"]}
    steps |= {"#avatar": ["talk"], "#record": ["talk"], "[data-source=microphone]": ["talk"]}
    menu = "document.getElementById('menu').getBoundingClientRect()"
    for step, panels in steps.items():
        driver.page.keyboard.press("Escape")
        if step:
            driver.click(step)
        driver.wait(f"{OPEN}.join() === '{','.join(panels)}'")  # some open when sound is ready
        assert driver.ask(PRESSED) == len(panels)
        driver.wait(f"!__echo.viewport.isGliding && {UNDER}.length === 0", seconds=40)
        time.sleep(0.5)
        assert driver.ask(UNDER) == []
        assert driver.ask(f"{menu}.right <= innerWidth - 11")
        driver.shot(tmp_path / f"{width}{step.strip('#[]')}.png")
    assert driver.problems == []


def test_a_microphone_shows_how_loud_it_is(new_tab, mock_url):
    """Chromium's fake microphone beeps once a second, Firefox's all the time."""
    page = new_tab(480, 360)
    page.need_sound()
    page.open(f"{mock_url}?quality=low")
    height = page.ask("document.querySelector('.bar').offsetHeight")
    page.click("[data-source=microphone]")
    page.click("#menu button:nth-of-type(2)")
    level = "document.querySelector('[data-source=microphone]').style.getPropertyValue('--level')"
    page.wait(f"Number({level}) > 0.3")
    assert page.ask("document.querySelector('.bar').offsetHeight") == height
    if not isinstance(page.page, FirefoxPage):
        page.wait(f"{level} !== '' && Number({level}) < 0.1")
    assert page.ask("__echo.sources.title") == ""  # no name for who dances to it
    page.click("#stop")
    page.wait(f"{level} === ''")
    time.sleep(1)
    assert page.ask(level) == ""
    assert page.problems == []


def test_characters_and_dropped_files_are_chosen_by_their_faces(page):
    chosen = """[...document.querySelectorAll("#menu button")].map((row) =>
      [row.dataset.choice, row.getAttribute("aria-checked"), row.querySelector("img")?.naturalWidth ?? 0])"""
    page.drop("boxes.vrm", make_vrm())
    page.wait("!!__echo.avatar.driver.vrm")
    page.click("#avatar")
    page.wait("!document.getElementById('menu').hidden")
    page.wait("[...document.querySelectorAll('#menu img')].every((image) => image.complete)")
    rows = [row for row in page.ask(chosen) if not row[0].startswith("watch")]
    assert [row[:2] for row in rows] == [
        ["maya", "false"], ["theo", "false"], ["amara", "false"], ["boxes.vrm", "true"], ["open", None],
    ]  # fmt: skip
    assert [row[2] for row in rows] == [96] * 4 + [0]
    for name, is_own in (("theo", False), ("boxes.vrm", True), ("maya", False)):
        if page.ask("document.getElementById('menu').hidden"):
            page.click("#avatar")
            page.wait("!document.getElementById('menu').hidden")
        page.click(f"#menu [data-choice='{name}']")
        page.wait(f"!!__echo.avatar.driver.vrm === {str(is_own).lower()}")
        address = {"theo": "?quality=low&character=theo", "maya": "?quality=low"}
        if not is_own:
            page.wait(f"location.search === '{address[name]}'")


def test_camera_and_light_are_chosen_and_stay_after_a_reload(page, mock_url):
    page.click("#look")
    page.click("#menu [data-choice=face]")
    page.click("#look")
    page.click("#menu [data-choice=dusk]")
    assert page.ask("[__echo.viewport.view, document.documentElement.dataset.theme]") == [2, "dark"]
    page.open(page.page.url)
    assert page.ask("[__echo.viewport.chosen, document.documentElement.dataset.theme]") == [2, "dark"]
    page.click("#look")
    checked = "[...document.querySelectorAll('#menu [aria-checked=true]')].map((row) => row.dataset.choice)"
    assert page.ask(checked) == ["face", "dusk", "quality-low"]
    page.click("#menu [data-choice=follow]")
    assert page.ask("[__echo.viewport.chosen, location.search]") == [None, "?quality=low"]


@pytest.mark.parametrize("width", [320, 390])
def test_a_telephone_shows_all_sources_and_is_helped_with_touches(new_page, mock_url, width, tmp_path):
    driver = new_page(width, 780, is_mobile=True, has_touch=True)
    driver.open(f"{mock_url}?quality=low")
    driver.wait("!document.querySelector('[data-source=chat]').hidden")
    driver.page.evaluate("document.querySelector('[data-source=music]').hidden = false")
    cut = """[...document.querySelectorAll(".source:not([hidden])")].filter((button) => {
      const [box, bar] = [button, button.parentElement].map((element) => element.getBoundingClientRect());
      const isOut = box.left < bar.left - 1 || box.right > bar.right + 1;
      return isOut || button.scrollWidth > button.clientWidth + 1 || box.width < 32;
    }).map((button) => button.textContent)"""
    assert driver.ask(cut) == []
    driver.click("#help")
    seen = """[...document.querySelectorAll(".keys, .touches")].filter((line) => line.checkVisibility())
      .map((line) => line.className)"""
    assert driver.ask(seen) == ["touches"]
    driver.shot(tmp_path / f"{width}.png")


def test_an_upright_window_is_recorded_upright_and_fills_it(new_page, mock_url):
    driver = new_page(390, 844, is_mobile=True, has_touch=True)
    driver.open(f"{mock_url}?quality=low")
    driver.click("#record")
    driver.click("#menu [data-choice=webm]")
    driver.wait("__echo.viewport.canvas.width === 1080 && __echo.viewport.canvas.height === 1920")
    assert driver.page.evaluate("getComputedStyle(__echo.viewport.canvas).objectFit") == "cover"


def test_a_file_that_cannot_be_read_is_named_with_the_cause(page):
    """As when it was moved away after it had been chosen."""
    page.page.evaluate("void (File.prototype.arrayBuffer = () => Promise.reject(new DOMException('gone')))")
    for name, kind in (("me.glb", "model/gltf-binary"), ("song.ogg", "audio/ogg")):
        page.drop(name, b"glTF", kind)
        told = "document.getElementById('toasts').textContent"
        page.wait(f"{told}.includes('“{name}” ') && {told}.includes('(gone)')")


PRESSABLE = """[...document.querySelectorAll("button")].filter((button) => {
  const [one, other] = [button, document.querySelector(".toast")].map((node) => node.getBoundingClientRect());
  const isApart = one.right < other.left || one.left > other.right || one.bottom < other.top || one.top > other.bottom;
  return button.checkVisibility({ visibilityProperty: true }) && !button.closest(".gone") && !isApart;
}).map((button) => button.id || button.textContent)"""


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1280, 800)])
def test_what_is_told_covers_nothing_that_can_be_pressed(new_page, mock_url, width, height):
    """At first, and with the actions shown."""
    driver = new_page(width, height)
    driver.open(f"{mock_url}?quality=low")
    for step in ("", "#begin"):
        if step:
            driver.click(step)
            driver.wait("document.getElementById('actions').checkVisibility()")
        driver.drop("notes.txt", b"no sound", "text/plain")
        driver.wait("!!document.querySelector('.toast')")
        assert driver.ask(PRESSABLE) == []
        driver.wait("!document.querySelector('.toast')")


DRAGGED = """(values) => {
  const node = document.querySelector("#manner input[name=liveliness]");
  for (const value of values) {
    node.value = value;
    node.dispatchEvent(new Event("input", { bubbles: true }));
  }
}"""


@pytest.mark.parametrize("fields", [(), ("liveliness",), ("liveliness", "handedness")])
def test_liveliness_is_chosen_by_a_slider_where_the_model_follows_it(new_tab, tmp_path, fields):
    told = []

    async def stream(socket):
        await greeted(socket)
        await socket.send_bytes(encode(ready(manner=fields)))
        async for data in socket.iter_bytes():
            if isinstance(message := decode_client(data), Manner):
                told.append((message.liveliness, message.handedness))

    driver = new_tab(*((1100, 700) if len(fields) == 2 else (390, 780)))
    with mocked(stream=stream) as url:
        driver.page.goto(f"{url}?quality=low", wait_until="commit")
        driver.wait("!!window.__echo && __echo.session.player !== null && !!__echo.avatar.driver")
        assert driver.ask("document.getElementById('gestures').hidden") == (not fields)
        if not fields:
            return driver.shot(tmp_path / "without.png")
        driver.page.keyboard.press("g")
        sliders = """["liveliness", "handedness"].filter(
          (name) => document.querySelector(`#manner input[name=${name}]`).checkVisibility())"""
        assert driver.ask(sliders) == list(fields)
        driver.shot(tmp_path / f"manner_{len(fields)}.png")
        driver.page.evaluate(DRAGGED, ["0.6", "0.75", "0.9"])  # the last place counts
        end = time.monotonic() + 10
        while not told and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(0.5)
        assert told == [(0.9, None)]
        driver.page.keyboard.press("l")
        assert driver.ask(sliders) == []  # one panel at a time
        assert driver.problems == []
