"""The page in a real browser against the real server with the default bundle: a visitor's first minute."""

import itertools
import json
from importlib.resources import files

import numpy as np
import pytest
from tests.web.make_vrm import make_vrm
from tests.web.test_page_in_browser import record_motion

from echoavatar.models.audio import read_audio
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.timing import SAMPLES_PER_MOTION_TOKEN

pytestmark = [pytest.mark.browser, pytest.mark.slow]
PATIENCE = 120  # seconds; the machine that runs this may be busy
POSE = "[...__echo.session.player.pose.rotations]"
FACE = "[...__echo.session.player.pose.face]"
HANDS = [at for at, name in enumerate(HUMANOID.names) if "Index" in name or "Middle" in name or "Thumb" in name]
ARMS = [HUMANOID.index(f"{side}{part}") for side in ("left", "right") for part in ("UpperArm", "LowerArm")]


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    return tmp_path_factory.mktemp("shots")


@pytest.fixture
def page(new_page, live_url):
    driver = new_page(480, 420)
    driver.open(f"{live_url}?quality=low")
    yield driver
    assert driver.problems == []


@pytest.fixture
def boxes(page):
    page.drop("boxes.vrm", make_vrm())
    page.wait("!!__echo.avatar.driver.vrm")
    return page


def test_the_sound_comes_as_opus_and_lies_on_its_sample(page):
    """Utterances begin with a chunk, so what was decoded is late by whole chunks and no sample more."""
    assert page.ask("__echo.session.ready.sound") == "opus"
    page.click("[data-source=speech]")
    page.wait("__echo.shown.state === 'speaking'", PATIENCE)
    page.wait("__echo.session.player.sounds.some((s) => s.at > __echo.session.heardOf.from + 48000)", PATIENCE)
    blocks = page.ask("__echo.session.player.sounds.map((s) => [s.at, [...s.pcm]])")
    assert all(at + len(pcm) == after for (at, pcm), (after, _) in itertools.pairwise(blocks))
    heard = np.concatenate([np.array(pcm) for _, pcm in blocks])
    speech = read_audio(files("echoavatar") / "assets" / "speech.ogg")
    size = len(heard) + len(speech)
    match = np.fft.irfft(np.fft.rfft(heard, size) * np.conj(np.fft.rfft(speech, size)), size)
    late = int(np.argmax(match))
    late -= size if late > len(heard) else 0
    assert (blocks[0][0] + late) % SAMPLES_PER_MOTION_TOKEN == 0  # the default bundle steps by one


class Seen:
    """The poses shown over some seconds."""

    def __init__(self, page, seconds):
        poses, faces = [], []
        for _ in range(round(seconds * 5)):
            poses.append(page.ask(POSE))
            faces.append(page.ask(FACE))
            page.page.wait_for_timeout(150)
        turns = np.array(poses).reshape(len(poses), -1, 4)
        dots = np.clip(np.abs((turns * turns[:1]).sum(-1)), 0, 1)
        self.turned = np.degrees(2 * np.arccos(dots)).max(0)  # largest rotation of each joint
        self.face = np.ptp(np.array(faces), axis=0)

    def mouth(self):
        return self.face[ARKIT_NAMES.index("jawOpen")]


def moves(page, degrees):
    """Wait until some joint has rotated that far."""
    before = np.array(page.ask(POSE)).reshape(-1, 4)
    for _ in range(PATIENCE * 4):
        now = np.array(page.ask(POSE)).reshape(-1, 4)
        dots = np.clip(np.abs((before * now).sum(1)), 0, 1)
        if np.degrees(2 * np.arccos(dots)).max() > degrees:
            return True
        page.page.wait_for_timeout(250)
    return False


def test_the_first_minute(page, shots):
    """Our own character breathes, speaks with mouth, arms and fingers, is interrupted, and dances."""
    assert moves(page, 0.5), "idle life"
    page.shot(shots / "idle.png")
    page.click("#begin")
    page.wait("__echo.shown.state === 'speaking' && __echo.sources.output.level > 0.02", PATIENCE)
    seen = Seen(page, 9)
    page.shot(shots / "speech.png")
    assert seen.mouth() > 0.1
    assert seen.turned[ARMS].max() > 8
    assert seen.turned[HANDS].max() > 3
    page.click("#stop")
    page.wait("__echo.session.player.played.epoch >= 1", PATIENCE)
    page.wait("__echo.shown.state !== 'speaking' && !__echo.shown.held", PATIENCE)
    page.click("[data-source=music]")
    if page.ask("__echo.session.ready.tracks.length > 1"):
        page.click("#menu button")
    page.wait("__echo.shown.state === 'dancing' && __echo.sources.output.level > 0.02", PATIENCE)
    assert moves(page, 20)
    page.shot(shots / "music.png")
    page.click("#stop")
    page.wait("__echo.shown.state !== 'dancing'", PATIENCE)


def test_an_uploaded_song_is_danced_to_and_the_label_says_so(page):
    song = (files("echoavatar") / "assets" / "music.ogg").read_bytes()
    page.drop("song.ogg", song, "audio/ogg")
    page.wait("document.getElementById('subtitle').textContent === 'Dancing'", PATIENCE)
    page.click("#stop")


def test_a_dropped_vrm_speaks_with_its_own_mouth_and_arms(boxes, shots):
    boxes.click("#begin")
    boxes.wait("__echo.shown.state === 'speaking'", PATIENCE)
    boxes.wait(
        "['aa', 'ih', 'ou', 'ee', 'oh'].some((v) => __echo.avatar.driver.vrm.expressionManager.getValue(v) > 0.1)",
        PATIENCE,
    )
    arm = "__echo.avatar.driver.vrm.humanoid.getNormalizedBoneNode('leftLowerArm').quaternion.x"
    before = boxes.ask(arm)
    boxes.wait(f"Math.abs({arm} - {before}) > 0.02", PATIENCE)
    boxes.shot(shots / "vrm.png")


@pytest.mark.parametrize("name", ["raise_both_hands", "bow", "agree"])
def test_an_action_is_done_and_told_of(boxes, shots, name):
    button = f"document.querySelector(`[data-action='{name}']`)"
    boxes.click(f"[data-action='{name}']")
    boxes.wait(f"{button}.dataset.status === 'started'", PATIENCE)
    boxes.wait("document.getElementById('subtitle').textContent !== ''", PATIENCE)
    assert moves(boxes, 5)
    boxes.shot(shots / f"{name}.png")
    boxes.wait(f"{button}.dataset.status === undefined", PATIENCE)


@pytest.mark.parametrize("kind", ["glb", "vrma", "bvh"])
def test_what_is_shown_is_recorded(page, tmp_path, kind):
    path = record_motion(page, kind, tmp_path)
    data = path.read_bytes()
    if kind == "bvh":
        motion = read_bvh(path)
        assert motion.skeleton.names == HUMANOID.names
        assert motion.frames >= 30
        return
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    (animation,) = document["animations"]
    assert sum(channel["target"]["path"] == "rotation" for channel in animation["channels"]) >= 20
    assert ("VRMC_vrm_animation" in document.get("extensionsUsed", [])) == (kind == "vrma")


def test_picture_and_sound_are_recorded(page, tmp_path):
    page.click("#begin")
    page.wait("__echo.shown.state === 'speaking'", PATIENCE)
    page.click("#record")
    page.click("#menu [data-choice=webm]")
    page.wait("__echo.tools.recording?.parts.length > 3", PATIENCE)
    data = page.download("#record", tmp_path).read_bytes()
    assert data[:4] == b"\x1aE\xdf\xa3"
    assert b"A_OPUS" in data
    assert b"V_VP" in data or b"V_AV1" in data


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_telephone_shows_it_all(new_page, live_url, shots, theme):
    driver = new_page(390, 844, is_mobile=True, has_touch=True, color_scheme=theme)
    driver.open(f"{live_url}?quality=low")
    driver.shot(shots / f"telephone_{theme}_welcome.png")
    driver.page.locator("#begin").tap(force=True)
    driver.wait("__echo.shown.state === 'speaking' && __echo.sources.output.level > 0.02", PATIENCE)
    assert moves(driver, 5)
    driver.click("[data-action=wave]")
    driver.wait("document.querySelector('[data-action=wave]').dataset.status === 'started'", PATIENCE)
    driver.shot(shots / f"telephone_{theme}.png")
    assert driver.ask("document.documentElement.dataset.theme") == theme
    assert driver.ask("document.documentElement.scrollWidth <= innerWidth")
    assert driver.problems == []


def test_a_broken_line_resumes_the_same_session(boxes):
    boxes.click("#begin")
    boxes.wait("__echo.shown.state === 'speaking'", PATIENCE)
    name, at = boxes.ask("[__echo.session.ready.session, __echo.metrics.at]")
    boxes.page.evaluate("__echo.session.connection.socket.close()")
    boxes.wait("__echo.session.ready.resumed", PATIENCE)
    boxes.wait(f"__echo.metrics.at > {at} + 48000", PATIENCE)
    assert boxes.ask("__echo.session.ready.session") == name
    boxes.wait("__echo.shown.state === 'speaking'", PATIENCE)  # the speech has pauses
