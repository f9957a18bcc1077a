"""The page in a real browser against a mock server: every control works."""

import json

import numpy as np
import pytest
from tests.web.make_vrm import make_vrm

from echoavatar.motion.kinematics import HUMANOID, read_bvh
from echoavatar.server.voice import find_voice

pytestmark = pytest.mark.browser


@pytest.fixture
def page(new_page, mock_url):
    driver = new_page(480, 360)
    driver.open(f"{mock_url}?quality=low")
    driver.drop("boxes.vrm", make_vrm())  # light, so that a software renderer keeps up
    driver.wait("!!__echo.avatar.driver.vrm")
    yield driver
    assert driver.problems == []


def test_a_dropped_vrm_moves_with_its_mouth_and_is_scaled_to_its_own_legs(page, tmp_path):
    page.click("#begin")
    page.wait("__echo.shown.state === 'speaking'")
    page.wait("__echo.avatar.driver.vrm.expressionManager.getValue('aa') > 0.05")
    hips = page.ask("__echo.avatar.driver.hips.position.y / __echo.session.player.pose.root[1]")
    assert hips == pytest.approx(0.8, abs=1e-3)
    arm = "__echo.avatar.driver.vrm.humanoid.getNormalizedBoneNode('leftUpperArm').quaternion.z"
    before = page.ask(arm)
    page.wait(f"Math.abs({arm} - {before}) > 0.02")
    page.shot(tmp_path / "vrm.png")


def test_speech_is_heard_and_interrupting_stops_it(page):
    page.click("[data-source=speech]")
    page.wait("__echo.shown.state === 'speaking' && __echo.sources.output.level > 0.02")
    page.wait("!document.getElementById('stop').disabled")
    page.click("#stop")
    page.wait("__echo.session.player.played.epoch === 1")
    page.wait("__echo.shown.state === 'idle' && !__echo.shown.held", seconds=10)
    page.wait("document.getElementById('stop').disabled", seconds=20)


def test_actions_show_what_became_of_them(page):
    page.click("[data-action=wave]")
    page.wait("document.querySelector('[data-action=wave]').dataset.status === 'started'")
    page.wait("document.getElementById('subtitle').textContent === 'Wave'")
    page.wait("document.querySelector('[data-action=wave]').dataset.status === undefined", seconds=10)


def test_the_microphone_can_be_the_voice(page):
    page.click("[data-source=microphone]")
    page.wait("!document.getElementById('menu').hidden")
    page.click("#menu button")
    page.wait("__echo.shown.state === 'speaking'")
    page.click("#stop")
    page.wait("__echo.session.player.played.epoch >= 1")


@pytest.mark.skipif(not find_voice(), reason="this machine has no voice")
def test_typed_text_is_said(page):
    page.wait("!document.querySelector('[data-source=text]').hidden")
    page.click("[data-source=text]")
    page.page.locator("#text").fill("Good morning, this is a test.")
    page.page.locator("#text").press("Enter")
    page.wait("__echo.shown.state === 'speaking'")
    page.wait("document.getElementById('text').value === ''")


def test_a_dropped_sound_is_played_and_nonsense_is_explained(page):
    page.drop("notes.txt", b"no sound at all", "text/plain")
    page.wait("document.getElementById('toasts').textContent.includes('holds no sound')")
    page.drop("broken.vrm", b"no model at all")
    page.wait("document.getElementById('toasts').textContent.includes('could not be worn')")
    assert page.ask("!!__echo.avatar.driver.vrm")


@pytest.mark.parametrize("kind", ["bvh", "vrma"])
def test_motion_is_recorded(page, kind, tmp_path):
    path = record_motion(page, kind, tmp_path)
    if kind == "vrma":
        assert path.read_bytes().startswith(b"glTF")
        return
    motion = read_bvh(path)
    assert motion.frames >= 30
    assert motion.fps == pytest.approx(30)
    assert motion.skeleton.names == HUMANOID.names
    assert np.abs(np.diff(motion.rotations[:, HUMANOID.names.index("leftUpperArm")], axis=0)).max() > 1e-4


def test_the_character_is_recorded_with_its_motion(new_page, mock_url, tmp_path):
    driver = new_page()
    driver.open(f"{mock_url}?quality=low")
    path = record_motion(driver, "glb", tmp_path)
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    (animation,) = document["animations"]
    assert sum(channel["target"]["path"] == "rotation" for channel in animation["channels"]) == HUMANOID.joints
    assert any(channel["target"]["path"] == "weights" for channel in animation["channels"])
    assert driver.problems == []


def record_motion(driver, kind, folder):
    driver.click("#begin")
    driver.wait("__echo.shown.state === 'speaking'")
    driver.click("#record")
    driver.click(f"#menu [data-choice={kind}]")
    driver.wait("__echo.tools.recording.take.frames.length >= 30")
    with driver.page.expect_download() as waiting:
        driver.click("#record")
    assert waiting.value.suggested_filename == f"echoavatar.{kind}"
    waiting.value.save_as(folder / f"take.{kind}")
    return folder / f"take.{kind}"


def test_picture_and_sound_are_recorded(page, tmp_path):
    page.click("#begin")
    page.click("#record")
    page.click("#menu [data-choice=webm]")
    page.wait("__echo.tools.recording.parts.length > 2")
    with page.page.expect_download() as waiting:
        page.click("#record")
    waiting.value.save_as(tmp_path / "take.webm")
    assert (tmp_path / "take.webm").read_bytes()[:4] == b"\x1aE\xdf\xa3"


def test_a_broken_line_comes_back_by_itself(page):
    page.page.evaluate("__echo.session.connection.socket.close()")
    page.wait("document.getElementById('line').textContent.includes('trying again')", seconds=5)
    page.wait("document.getElementById('line').textContent === '' && __echo.session.player.ahead > 0", seconds=20)


@pytest.mark.parametrize(("width", "height"), [(390, 780), (480, 420), (844, 390), (1280, 720)])
def test_nothing_is_cut_off(new_page, mock_url, width, height, tmp_path):
    driver = new_page(width, height)
    driver.open(f"{mock_url}?quality=low")
    outside = """[...document.querySelectorAll("button, h2, footer, header")].filter((element) => {
      const box = element.getBoundingClientRect();
      const scrolls = element.closest(".chips, .sources");
      const wide = box.left < -1 || box.right > innerWidth + 1;
      return box.width && !scrolls && (wide || box.top < -1 || box.bottom > innerHeight + 1);
    }).map((element) => element.id || element.textContent)"""
    assert driver.ask(outside) == []
    driver.click("#begin")
    driver.wait("document.getElementById('welcome').classList.contains('gone')")
    assert driver.ask(outside) == []
    assert driver.ask("document.getElementById('stop').getBoundingClientRect().width > 40")
    driver.shot(tmp_path / f"{width}.png")


def test_every_control_has_a_name(new_page, mock_url):
    driver = new_page()
    driver.open(f"{mock_url}?quality=low")
    nameless = """[...document.querySelectorAll("button, input:not([hidden])")]
      .filter((element) => !(element.getAttribute("aria-label") || element.textContent.trim())).length"""
    assert driver.ask(nameless) == 0
