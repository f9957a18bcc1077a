import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.errors import MotionError
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import GltfAnimation, pack_glb
from echoavatar.files.avatar.page import PageClip, page_text

JAW = 17  # jawOpen
CHROMIUM = Path("/usr/bin/chromium")

Wave = Callable[[int], tuple[np.ndarray, np.ndarray]]


def tone(seconds: float) -> bytes:
    samples = 0.1 * np.sin(2 * np.pi * 220 * np.arange(int(24_000 * seconds)) / 24_000)
    file = io.BytesIO()
    soundfile.write(file, samples, 24_000, format="OGG", subtype="VORBIS")
    return file.getvalue()


def make_page(path: Path, wave: Wave) -> None:
    talk = np.zeros((120, 52), np.float32)
    talk[:, JAW] = np.linspace(0, 1, 120)
    animations = [GltfAnimation("speech", *wave(120), face=talk), GltfAnimation("music", *wave(90))]
    clips = [PageClip("Speech <1>", "speech", tone(4), note="</script><b>"), PageClip("Music", "music", tone(3))]
    glb = pack_glb(load_character(), animations, compact=True)
    path.write_text(page_text(glb, clips, title="Echo & co", note="look"), "utf-8")


def test_the_page_stands_alone(tmp_path: Path, wave: Wave) -> None:
    make_page(tmp_path / "page.html", wave)
    text = (tmp_path / "page.html").read_text("utf-8")
    assert text.count("</script>") == 3  # nothing inside closes a script early
    assert not re.search(r"""(src|href)=["']?https?:""", text)
    assert "@TITLE@" not in text
    assert "<h1>Echo &amp; co</h1>" in text
    assert "three.js authors" in text
    assert "pixiv Inc." in text
    data = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.S)[1])  # type: ignore[index]
    assert [clip["title"] for clip in data["clips"]] == ["Speech <1>", "Music"]
    assert data["clips"][0]["audio"].startswith("data:audio/ogg;base64,")


def test_clips_must_name_an_animation(wave: Wave) -> None:
    glb = pack_glb(load_character(), [GltfAnimation("speech", *wave(10))])
    with pytest.raises(MotionError, match="'dance'"):
        page_text(glb, [PageClip("x", "dance", b"")])


@pytest.mark.browser
def test_the_avatar_moves_with_the_sound(tmp_path: Path, wave: Wave) -> None:
    sync_api = pytest.importorskip("playwright.sync_api")
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is missing")
    make_page(tmp_path / "page.html", wave)
    troubles: list[str] = []
    where = """async (seconds) => {
        const { player, bones, faces, draw, THREE } = await window.echoavatar;
        if (seconds !== null) {
            await new Promise((done) => { player.audio.onseeked = done; player.seek(seconds); });
            draw();
        }
        const at = new THREE.Vector3();
        bones.rightHand.getWorldPosition(at);
        const jaws = faces.map((mesh) => mesh.morphTargetInfluences[mesh.morphTargetDictionary.jawOpen]);
        return [player.audio.currentTime, at.x, at.y, at.z, ...jaws];
    }"""
    with sync_api.sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=str(CHROMIUM), args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page = browser.new_page(viewport={"width": 390, "height": 700})
        page.set_default_timeout(120_000)
        page.on("console", lambda message: message.type == "error" and troubles.append(message.text))
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.goto(f"{(tmp_path / 'page.html').as_uri()}?quality=low", wait_until="domcontentloaded")
        page.evaluate("async () => { await window.echoavatar; }")
        first, second = page.evaluate(where, 0.2), page.evaluate(where, 1.2)
        page.click("#start")
        page.wait_for_timeout(1500)
        third = page.evaluate(where, None)
        page.click("#clips button:nth-child(2)")
        assert page.get_attribute("#clips button:nth-child(2)", "aria-pressed") == "true"
        assert not page.is_visible("#start")
        browser.close()
    assert troubles == []
    assert np.linalg.norm(np.subtract(first[1:4], second[1:4])) > 0.1
    np.testing.assert_allclose(first[4:], 0.2 * 30 / 119, atol=0.01)  # the jaw, on every mesh of the face
    np.testing.assert_allclose(second[4:], 1.2 * 30 / 119, atol=0.01)
    assert len(second) > 6
    assert third[0] > second[0]
