"""The page in a real browser against a mock server: every control works."""

import io
import json
import time

import av
import numpy as np
import pytest
import soundfile
from starlette.responses import JSONResponse
from starlette.routing import Route
from tests.files.exports.bodies import long_armed
from tests.motion.formats.repacked import in_parts, oddly_drawn, taken_apart, with_draco, with_meshopt
from tests.web.conftest import mocked
from tests.web.ktx2 import make_ktx2, with_ktx2
from tests.web.make_vrm import make_vrm

from echoavatar.files.avatar.backdrop import BACKDROPS
from echoavatar.files.avatar.gltf import container
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.server.voice import find_voice

pytestmark = pytest.mark.browser


@pytest.fixture
def page(new_tab, mock_url):
    driver = new_tab(480, 360)
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


FORMS = {"oddly drawn": oddly_drawn, "draco": with_draco, "meshopt": with_meshopt}


@pytest.mark.parametrize("form", FORMS)
def test_a_dropped_glb_of_another_program_opens_its_mouth(new_page, mock_url, form, tmp_path):
    """Compressed or not; its one morph target is called as Maya and Character Creator would."""
    document, binary = taken_apart(long_armed())
    document["meshes"][1]["extras"] = {"targetNames": ["blendShape1.Jaw_Open"]}
    driver = new_page(480, 360)
    driver.open(f"{mock_url}?quality=low")
    driver.drop("boxes.glb", FORMS[form](container(document, binary)))
    driver.wait("__echo.avatar.driver.object.getObjectByName('mixamorigHips') !== undefined")
    driver.wait("document.getElementById('toasts').textContent.includes('eyeBlinkLeft')")
    driver.click("#begin")
    driver.wait("__echo.shown.state === 'speaking'")
    driver.wait("__echo.avatar.driver.object.getObjectByName('mouth').morphTargetInfluences[0] > 0.05")
    driver.shot(tmp_path / f"{form}.png")
    assert driver.problems == []


def test_a_gltf_is_dropped_with_its_parts(new_page, mock_url, tmp_path):
    path = in_parts(long_armed(), tmp_path / "in")
    files = {part.name: part.read_bytes() for part in path.parent.rglob("*") if part.is_file()}
    document = json.loads(files[path.name])
    del document["images"]
    files[path.name] = json.dumps(document).encode()
    driver = new_page(480, 360)
    driver.open(f"{mock_url}?quality=low")
    driver.drop_all({path.name: files[path.name]})
    driver.wait("document.getElementById('toasts').textContent.includes('is not there')")
    driver.drop_all(files)
    driver.wait("__echo.avatar.driver.object.getObjectByName('mixamorigHips') !== undefined")
    assert driver.problems == []


RED = (220, 30, 60, 255)


def test_ktx2_textures_are_shown(new_page, mock_url, tmp_path):
    """The body is red by its texture alone, and what unpacks that is fetched for this file, not before."""
    driver, asked = new_page(480, 360), []
    driver.page.on("request", lambda request: asked.append(request.url))
    driver.open(f"{mock_url}?quality=low")
    assert not [url for url in asked if "transcode" in url]
    driver.drop("boxes.glb", with_ktx2(*taken_apart(long_armed()), make_ktx2(RED)))
    driver.wait("__echo.avatar.driver.object.getObjectByName('mixamorigHips') !== undefined")
    driver.wait("document.getElementById('toasts').textContent.includes('eyeBlinkLeft')")
    red = """(() => {
      const { renderer } = __echo.viewport;
      __echo.viewport.render(0);
      const gl = renderer.getContext();
      const pixels = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
      gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      let found = 0;
      for (let k = 0; k < pixels.length; k += 4) found += pixels[k] > 60 && pixels[k] > 2.5 * pixels[k + 1];
      return found;
    })()"""
    assert driver.ask(red) > 300
    driver.shot(tmp_path / "ktx2.png")
    assert driver.problems == []


HOSTILE = {
    "cut off after": make_ktx2(RED, 64)[:-200],
    "has 65536 x 65536 pixels": make_ktx2(RED, claimed=65536),
    "is damaged": make_ktx2(RED, claimed=4096),
    "is not KTX2": b"\x89PNG" + bytes(200),
}


@pytest.mark.parametrize("told", HOSTILE)
def test_a_hostile_ktx2_is_refused_with_file_and_cause(page, told):
    before = page.ask("__echo.avatar.driver.object.uuid")
    page.drop("boxes.glb", with_ktx2(*taken_apart(long_armed()), HOSTILE[told]))
    page.wait(f"document.getElementById('toasts').textContent.includes('{told}')")
    assert "“boxes.glb” could not be worn" in page.ask("document.getElementById('toasts').textContent")
    assert page.ask("__echo.avatar.driver.object.uuid") == before
    page.problems[:] = [problem for problem in page.problems if "Couldn't load texture" not in problem]


def test_a_picture_that_cannot_be_decoded_is_told(page):
    data = with_ktx2(*taken_apart(long_armed()), b"\x89PNG" + bytes(200))
    document, binary = taken_apart(data)
    document["images"][0]["mimeType"] = "image/png"
    document["textures"] = [{"source": 0}]
    del document["extensionsUsed"], document["extensionsRequired"]
    page.drop("boxes.glb", container(document, binary))
    page.wait("document.getElementById('toasts').textContent.includes('1 of its pictures cannot be read')")
    page.problems[:] = [problem for problem in page.problems if "Couldn't load texture" not in problem]


def pauses() -> bytes:
    """Sound of 20 s with a hole of 1.6 s every 3 s."""
    seconds = np.arange(20 * 24_000) / 24_000
    out = io.BytesIO()
    soundfile.write(out, 0.3 * np.sin(seconds * 1_500) * (seconds % 3 < 1.4), 24_000, format="WAV")
    return out.getvalue()


def test_speech_is_heard_and_interrupting_stops_it(page):
    page.click("[data-source=speech]")
    page.wait("__echo.shown.state === 'speaking' && __echo.sources.output.level > 0.02")
    page.wait("!document.getElementById('stop').disabled")
    page.click("#stop")
    page.wait("__echo.session.player.played.epoch === 1")
    page.wait("__echo.shown.state === 'idle' && !__echo.shown.held", seconds=10)
    page.wait("document.getElementById('stop').disabled", seconds=20)


def test_a_sound_is_one_sound_with_its_pauses_and_pressed_again_it_restarts(page):
    """The label stays, Interrupt stays, and nothing is queued behind what still plays."""
    page.drop("pauses.wav", pauses(), "audio/wav")
    page.wait("__echo.shown.state === 'speaking'")
    page.wait("document.getElementById('subtitle').textContent === 'Speaking'")
    subtitle, stop = (f"document.getElementById('{name}')" for name in ("subtitle", "stop"))
    looks = f"[__echo.shown.state, {subtitle}.textContent, {stop}.disabled]"
    seen = []
    for _ in range(60):
        seen.append(page.ask(looks))
        time.sleep(0.1)
    assert "idle" in {state for state, _, _ in seen}  # a pause was seen
    assert {(label, grey) for _, label, grey in seen} == {("Speaking", False)}
    before = page.ask("__echo.session.segments.avatar")
    page.click("[data-source=speech]")
    page.wait(f"__echo.session.player.played.epoch >= 1 && __echo.session.segments.avatar === {before + 1}")
    page.click("#stop")
    page.wait("document.getElementById('stop').disabled", seconds=20)


def test_listening_ends_with_the_microphone(page):
    page.click("[data-source=microphone]")
    page.wait("!document.getElementById('menu').hidden")
    page.click("#menu button:nth-of-type(2)")
    page.wait("__echo.shown.state === 'listening'")
    assert page.ask("document.getElementById('stop').disabled") is False
    page.click("#stop")
    page.wait("__echo.shown.state === 'idle'")


def test_without_a_voice_nothing_is_offered_and_it_says_what_to_install(new_tab):
    async def voice(_):
        return JSONResponse({"voice": "", "voices": [], "install": "pip install it"})

    driver = new_tab()
    with mocked(routes=[Route("/v1/voice", voice)]) as url:
        driver.open(f"{url}?quality=low")
        driver.wait("!document.querySelector('[data-source=chat]').hidden")
        assert driver.ask("document.querySelector('[data-source=text]').hidden")
        driver.click("#help")
        shown = """[...document.querySelectorAll(".unvoiced")].filter((note) => note.checkVisibility())
          .map((note) => note.textContent)"""
        (told,) = driver.ask(shown)
        assert "pip install it" in told


def test_raised_hands_stay_in_the_picture(page):
    """A hand high over the head and one far to the side, held for two seconds."""
    page.page.evaluate("__echo.viewport.frame(1)")
    for place in ([0.1, 1.28, 0.1], [0.6, 0.8, 0.1]):  # of the body's height
        inside = """(place) => {
          const { viewport, avatar } = __echo;
          const [x, y, z] = place.map((part) => part * viewport.tall);
          const point = avatar.here.clone().set(x + avatar.here.x, y, z + avatar.here.z);
          for (let k = 0; k < 60; k++) {
            viewport.camera.updateMatrixWorld();
            viewport.attend([point], 1 / 30);
          }
          viewport.camera.updateMatrixWorld();
          point.project(viewport.camera);
          return Math.max(Math.abs(point.x), Math.abs(point.y));
        }"""
        assert page.page.evaluate(inside, place) < 1


def test_the_meter_counts_pictures(page):
    count = "__echo.viewport.renderer.info.render.frame"
    before, begun, told = page.ask(count), time.monotonic(), []
    for _ in range(3):  # the meter tells of its last second, and a busy machine's seconds differ
        time.sleep(1)
        told.append(page.ask("__echo.metrics.fps"))
    drawn = (page.ask(count) - before) / (time.monotonic() - begun)
    assert np.mean(told) == pytest.approx(drawn, rel=0.5, abs=3)


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
    page.write("#text", "Good morning, this is a test.")
    page.wait("__echo.shown.state === 'speaking'")
    page.wait("document.getElementById('text').value === ''")


def test_a_dropped_sound_is_played_and_nonsense_is_explained(page):
    page.drop("notes.txt", b"no sound at all", "text/plain")
    page.wait("document.getElementById('toasts').textContent.includes('holds no sound')")
    whole = make_vrm()
    for data, told in (
        (b"no model at all", "is not a .vrm, .glb or .gltf"),
        (b'{"buffers": [{"uri": "body.bin"}]}', "refers to “body.bin”"),
        (whole[:-99], "cut off"),
    ):
        page.drop("broken.vrm", data)
        page.wait(f"document.getElementById('toasts').textContent.includes('{told}')")
    page.drop("broken.vrm", whole[:24] + b"#" * 40 + whole[64:])
    page.wait("document.getElementById('toasts').textContent.includes('damaged inside')")
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


TRIANGLES = "__echo.viewport.renderer.info.render.triangles"


def test_software_gl_gets_low_quality_and_the_coarsest_level_and_may_ask_for_more(new_page, mock_url):
    asked = []
    for query, quality in (("", "low"), ("?quality=high", "high")):
        driver = new_page()
        driver.page.on("request", lambda request: "avatar.glb" in request.url and asked.append(request.url))
        driver.open(f"{mock_url}{query}")
        assert driver.ask("document.documentElement.dataset.quality") == quality
        driver.page.evaluate("for (let k = 0; k < 600; k++) __echo.detail.picture(1 / 60)")
        time.sleep(1)
        assert {url.partition("?")[2] for url in asked} == {"level=2"}
        assert driver.ask("__echo.viewport.low") is (quality == "low")
        assert driver.problems == []


def test_a_quick_machine_gets_a_finer_character_and_a_slow_one_gives_it_back(new_page, mock_url):
    """Where WebGL tells that it is a graphics card's, frame times decide; here they are made up."""
    driver = new_page()
    driver.page.add_init_script("""
      const told = WebGL2RenderingContext.prototype.getParameter;
      WebGL2RenderingContext.prototype.getParameter = function (name) {
        return name === 0x9246 ? "A card" : told.call(this, name); // UNMASKED_RENDERER_WEBGL
      };""")
    asked = []
    driver.page.on("request", lambda request: "avatar.glb" in request.url and asked.append(request.url[-7:]))
    driver.open(f"{mock_url}?character=theo")
    assert driver.ask("document.documentElement.dataset.quality") == "high"
    driver.wait(f"{TRIANGLES} > 1000")
    coarse = driver.ask(TRIANGLES)
    hips = driver.ask("__echo.avatar.driver.hips.uuid")
    play = "for (let k = 0; k < 200; k++) __echo.detail.picture({0}); __echo.avatar.show(__echo.avatar.ours, {1})"
    driver.page.evaluate(play.format("1 / 60", "__echo.detail.level"))
    driver.wait(f"{TRIANGLES} > {3 * coarse} && __echo.avatar.driver.hips.uuid !== '{hips}'")
    driver.page.evaluate("for (let k = 0; k < 200; k++) __echo.detail.picture(1 / 15)")
    assert driver.ask("__echo.detail.level") == 2
    assert asked[0] == "level=2"
    assert "level=0" in asked
    assert driver.problems == []


@pytest.mark.parametrize("background", ["studio", "dusk", "plain", "clear"])
def test_a_stage_is_chosen_by_name_and_clear_has_alpha(new_page, mock_url, background):
    """The upper corners are read from the canvas, right after it was drawn."""
    driver = new_page()
    driver.open(f"{mock_url}?quality=low&background={background}")
    corner = """(() => {
      const { renderer } = __echo.viewport;
      __echo.viewport.render(0);
      const gl = renderer.getContext();
      const pixel = new Uint8Array(4);
      gl.readPixels(gl.drawingBufferWidth >> 1, gl.drawingBufferHeight - 1, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      return [...pixel];
    })()"""
    seen = driver.ask(corner)
    if background == "clear":
        assert seen == [0, 0, 0, 0]
    else:
        assert seen == pytest.approx([*BACKDROPS[background].top, 255], abs=2)
        assert driver.ask("document.documentElement.dataset.theme") == ("dark" if background == "dusk" else "light")
    assert driver.problems == []


def test_low_quality_has_the_light_of_high_quality_and_no_shadow_map(new_page, mock_url):
    """What the lights send, not what a slow machine draws: skin keeps its tone where the light is the same."""
    driver = new_page()
    driver.open(f"{mock_url}?quality=low&background=studio")
    lights = """(() => {
      const found = {};
      __echo.viewport.scene.traverse((node) => node.isLight && (found[node.type] ??= []).push(
        [...node.color.toArray(), ...(node.groundColor?.toArray() ?? [])].map((part) => part * node.intensity / Math.PI)
      ));
      return found;
    })()"""
    look, found = BACKDROPS["studio"].look, driver.ask(lights)
    np.testing.assert_allclose(found["HemisphereLight"][0], np.concatenate([look[2], look[3]]), atol=1e-3)
    np.testing.assert_allclose(found["DirectionalLight"], look[[1, 5]], atol=1e-3)
    assert driver.ask("__echo.viewport.renderer.shadowMap.enabled") is False


def test_the_character_is_recorded_with_its_motion(new_tab, mock_url, tmp_path):
    driver = new_tab()
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
    driver.wait("__echo.tools.recording?.take.frames.length >= 30")
    path = driver.download("#record", folder)
    assert path.name == f"echoavatar.{kind}"
    return path


def test_picture_and_sound_are_recorded(page, tmp_path):
    page.click("#begin")
    page.click("#record")
    page.click("#menu [data-choice=webm]")
    page.wait("__echo.tools.recording?.parts.length > 2")
    with av.open(str(page.download("#record", tmp_path))) as film:
        (picture,) = film.streams.video
        assert (picture.width, picture.height) == (1920, 1080)
        assert film.duration is not None
        assert film.duration / av.time_base > 2
    assert page.ask("__echo.viewport.canvas.width") < 1000  # the page's own size again


def test_a_broken_line_comes_back_by_itself(page):
    page.page.evaluate("__echo.session.connection.socket.close()")
    page.wait("document.getElementById('line').textContent.includes('trying again')", seconds=5)
    assert page.ask("document.getElementById('line').checkVisibility()")  # also in a small window
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


OVERLAPS = """(() => {
  const found = [...document.querySelectorAll("h1, h2, header button, .line, .welcome p, .welcome button, " +
    ".subtitle, #hud, #actions button, .dock button")].filter((element) =>
    element.textContent.trim() + element.innerHTML && element.checkVisibility({ opacityProperty: true })
    && element.getBoundingClientRect().width > 1 && !element.closest(".gone"));
  const clipped = (element) => {
    let { left, top, right, bottom } = element.getBoundingClientRect();
    for (let at = element.parentElement; at; at = at.parentElement) {
      if (getComputedStyle(at).overflowX === "visible") continue;
      const box = at.getBoundingClientRect();
      [left, top] = [Math.max(left, box.left), Math.max(top, box.top)];
      [right, bottom] = [Math.min(right, box.right), Math.min(bottom, box.bottom)];
    }
    return { left, top, right, bottom };
  };
  const named = (element) => element.id || element.getAttribute("aria-label") || element.textContent.trim();
  const pairs = [];
  found.forEach((one, k) => found.slice(k + 1).forEach((other) => {
    if (one.contains(other) || other.contains(one)) return;
    const [a, b] = [clipped(one), clipped(other)];
    const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (wide > 1 && high > 1) pairs.push(`${named(one)} and ${named(other)}`);
  }));
  return { pairs, count: found.length };
})()"""


# Whether the label of what the avatar does is within the box around its joints.
ON_THE_BODY = """(() => {
  const { viewport, avatar } = __echo;
  const label = document.getElementById("subtitle").getBoundingClientRect();
  viewport.camera.updateMatrixWorld();
  const places = [];
  avatar.driver.hips.traverse((bone) => {
    const { x, y } = bone.getWorldPosition(avatar.here.clone()).project(viewport.camera);
    places.push([((x + 1) / 2) * innerWidth, ((1 - y) / 2) * innerHeight]);
  });
  const [across, down] = [0, 1].map((axis) => places.map((place) => place[axis]));
  return Math.max(...across) > label.left && Math.min(...across) < label.right
    && Math.max(...down) > label.top && Math.min(...down) < label.bottom;
})()"""


@pytest.mark.parametrize(("width", "height"), [(390, 780), (844, 390), (1280, 720)])
def test_labels_do_not_overlap(new_page, mock_url, width, height, tmp_path):
    """At first, while it speaks, and with the meters open; the body is free while it speaks."""
    driver = new_page(width, height)
    driver.open(f"{mock_url}?quality=low")
    for step in ("", "#begin", "#meters"):
        if step:
            driver.click(step)
            driver.wait("document.getElementById('subtitle').textContent === 'Speaking'")
            time.sleep(1)  # what fades has faded
        found = driver.ask(OVERLAPS)
        driver.shot(tmp_path / f"{width}{step}.png")
        assert found["count"] > 8
        assert found["pairs"] == [], step or "at first"
        assert not step or not driver.ask(ON_THE_BODY)


def test_the_picture_reframes_on_resize(new_page, mock_url):
    """From wide to narrow and back: the camera's shape is the window's, and head and feet stay in the picture."""
    driver = new_page(640, 360)
    driver.open(f"{mock_url}?quality=low")
    ends = """[0.02, 0.97].map((share) => {
      const { viewport, avatar } = __echo;
      viewport.camera.updateMatrixWorld();
      const { x, z } = avatar.here;
      const point = avatar.here.clone().set(x, share * viewport.tall, z).project(viewport.camera);
      return [point.x, point.y];
    })"""
    for width, height in ((300, 640), (640, 360)):
        driver.page.set_viewport_size({"width": width, "height": height})
        driver.wait(f"Math.abs(__echo.viewport.camera.aspect - {width / height}) < 0.01")
        driver.wait("!__echo.viewport.isGliding", seconds=30)
        assert np.abs(driver.ask(ends)).max() < 1
        canvas = driver.ask("[__echo.viewport.canvas.clientWidth, __echo.viewport.canvas.clientHeight]")
        assert canvas == [width, height]
    assert driver.problems == []


def test_every_control_has_a_name(new_page, mock_url):
    driver = new_page()
    driver.open(f"{mock_url}?quality=low")
    nameless = """[...document.querySelectorAll("button, input:not([hidden])")]
      .filter((element) => !(element.getAttribute("aria-label") || element.textContent.trim())).length"""
    assert driver.ask(nameless) == 0
