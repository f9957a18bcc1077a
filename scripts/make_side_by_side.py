"""Draw the same poses by the page and by the film, with the same cameras and light: docs/img/page_and_film.webp.

    python tests/web/mock_server.py --port 8790 &      # any server of the page will do
    python scripts/make_side_by_side.py http://127.0.0.1:8790/

Above the page (high quality, finest level), below the film: rest and speech in the studio, dance and a face at dusk.
The motion is the default bundle's. Needs the extras `render` and `browser`, and a system Chromium; some minutes.
"""

import base64
import io
import math
import shutil
import sys
import time
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from echoavatar.engine import animate, in_blocks
from echoavatar.engine.pipeline import Pipeline, load_bundle
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.avatar_renderer import AvatarRenderer, Shot
from echoavatar.files.avatar.framing import aimed
from echoavatar.files.avatar.render import Camera
from echoavatar.models.audio import read_audio
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.timing import SAMPLE_RATE_HZ

TARGET = Path(__file__).parents[1] / "docs" / "img" / "page_and_film.webp"
SIZE = (300, 400)
SECONDS = 6.0  # of sound, whose frame AT is drawn
AT = 140
LOWERED = {"leftUpperArm": -1.2, "rightUpperArm": 1.2}  # radians about Z
WAIT_S = 180
# Stops what the page shows by itself.
HOLD = """
async () => {
  const { avatar, session, viewport } = __echo;
  await avatar.show(avatar.ours, 0);
  session.picture = () => null;
  avatar.follow = () => {};
  viewport.render = () => {};
}
"""
# Draws one pose by the page's own driver, light and renderer, twice as wide and high as it is kept.
DRAW = """
([rotations, root, face, position, target, fov, [width, height]]) => {
  const { avatar, viewport } = __echo;
  const { camera, renderer, scene } = viewport;
  avatar.driver.apply({
    rotations: Float32Array.from(rotations), root: Float32Array.from(root), face: Float32Array.from(face),
  });
  viewport.follow(root[0], root[2], 1);
  viewport.echoes.mesh.visible = false;
  camera.clearViewOffset();
  Object.assign(camera, { fov, aspect: width / height });
  camera.position.set(...position);
  camera.lookAt(...target);
  camera.updateProjectionMatrix();
  renderer.setPixelRatio(2);
  renderer.setSize(width, height, false);
  scene.updateMatrixWorld(true);
  viewport.light.update();
  renderer.render(scene, camera);
  return renderer.domElement.toDataURL("image/png");
}
"""


class Still(NamedTuple):
    """One frame to draw, its stage and its camera."""

    motion: Motion
    face: Float[np.ndarray, " 52"]
    stage: str
    camera: Camera


def main() -> None:
    """Write the picture."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    stills = chosen()
    film = np.concatenate([by_film(still) for still in stills], 1)
    page = np.concatenate(by_page(sys.argv[1], stills), 1)
    Image.fromarray(np.concatenate([page, film])).save(TARGET, quality=82, method=6)
    print(f"wrote {TARGET}")


def chosen() -> list[Still]:
    """Rest, speech, dance and a face."""
    pipeline = Pipeline(load_bundle("default"))
    speech, dance = (performed(pipeline, name, start) for name, start in (("speech.ogg", 0.0), ("music.ogg", 4.0)))
    rotations = np.zeros((1, HUMANOID.joints, 4), np.float32)
    rotations[..., 0] = 1
    for name, angle in LOWERED.items():
        rotations[0, HUMANOID.index(name), [0, 3]] = math.cos(angle / 2), math.sin(angle / 2)
    root = np.array([[0.0, HUMANOID.config.offsets[0][1], 0.0]], np.float32)
    rest = Motion(HUMANOID, rotations, root, 30.0), np.zeros(52, np.float32)
    head = speech[0].pose().positions[0, HUMANOID.index("head")]
    return [
        Still(*rest, "studio", aimed("front", root[0])),
        Still(*speech, "studio", aimed("front", speech[0].root[0])),
        Still(*dance, "dusk", aimed("front", dance[0].root[0])),
        Still(*speech, "dusk", aimed("face", head)),
    ]


def performed(pipeline: Pipeline, sound: str, start: float) -> tuple[Motion, Float[np.ndarray, " 52"]]:
    """One frame of what the bundle does to a sound of the package."""
    with as_file(files("echoavatar") / "assets" / sound) as path:
        audio = read_audio(path)
    first = round(start * SAMPLE_RATE_HZ)
    made = animate(pipeline, in_blocks(audio[first : first + round(SECONDS * SAMPLE_RATE_HZ)]), seed=0)
    one = Motion(HUMANOID, made.motion.rotations[AT : AT + 1], made.motion.root[AT : AT + 1], made.motion.fps)
    return one, np.zeros(52, np.float32) if made.face is None else made.face[AT]


def by_page(url: str, stills: list[Still]) -> list[UInt8[np.ndarray, "h w 3"]]:
    """The page's pictures."""
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    drawn, shown = [], ""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=[*flags, "--ignore-gpu-blocklist"])
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        for still in stills:
            if still.stage != shown:
                open_page(page, f"{url}?quality=high&background={still.stage}")
                shown = still.stage
            drawn.append(shrunk(base64.b64decode(page.evaluate(DRAW, told(still)).partition(",")[2])))
        browser.close()
    return drawn


def open_page(page: Any, address: str) -> None:
    """Open the page and stop it."""
    page.goto(address, wait_until="commit", timeout=1000 * WAIT_S)
    end = time.monotonic() + WAIT_S
    while not page.evaluate("!!(window.__echo && __echo.avatar.driver?.hips)"):
        if time.monotonic() > end:
            sys.exit(f"the page showed no avatar in {WAIT_S} s")
        time.sleep(0.3)
    page.evaluate(HOLD)


def told(still: Still) -> list[Any]:
    """What DRAW takes."""
    turns = np.roll(still.motion.rotations[0], -1, axis=1)  # three.js has w last
    root, camera = still.motion.root[0], still.camera
    lens = math.degrees(camera.field_of_view)
    return [turns.ravel().tolist(), root.tolist(), still.face.tolist(), camera.position, camera.target, lens, SIZE]


def by_film(still: Still) -> UInt8[np.ndarray, "h w 3"]:
    """The film's picture."""
    pose = still.motion.pose()
    renderer = AvatarRenderer(load_character(), Shot((2 * SIZE[0], 2 * SIZE[1]), background=still.stage))
    picture = renderer.draw(pose.rotations[0], pose.positions[0], still.face, still.camera)
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "png")
    return shrunk(out.getvalue())


def shrunk(data: bytes) -> UInt8[np.ndarray, "h w 3"]:
    """A picture at the size in which it is kept."""
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB").resize(SIZE, Image.Resampling.LANCZOS))


if __name__ == "__main__":
    main()
