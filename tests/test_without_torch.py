"""What needs no model loads no torch: it costs seconds and hundreds of megabytes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import echoavatar
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion

EVERY_MODULE = """
import importlib, pkgutil, sys
package = importlib.import_module("echoavatar.{room}")
for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    importlib.import_module(found.name)
    assert "torch" not in sys.modules, found.name
"""
COMMANDS = """
import sys
from echoavatar.cli import main
for words in (
    "export clip.bvh -o clip.glb",
    "export clip.bvh -o clip.npz",
    "export clip.npz -o other.bvh --rig clip.bvh",
    "rig clip.glb -o body.json",
    "export clip.npz -o own.glb --rig clip.glb",
):
    assert main(words.split()) == 0
    assert "torch" not in sys.modules, words
"""


FACE = """
import sys
import echoavatar.models.audio.level, echoavatar.models.face.stream
assert "torch" not in sys.modules
"""


def run(code: str, folder: Path) -> None:
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("room", ["motion", "files"])
def test_no_module_of_the_room_loads_it(room: str, tmp_path: Path) -> None:
    run(EVERY_MODULE.format(room=room), tmp_path)


def test_the_face_and_level_control_load_none(tmp_path: Path) -> None:
    run(FACE, tmp_path)


def test_recordings_are_written_and_put_on_a_character_without_it(tmp_path: Path) -> None:
    still = Motion.at_rest(HUMANOID)
    rotations, root = np.repeat(still.rotations, 4, 0), np.repeat(still.root, 4, 0)
    write_bvh(tmp_path / "clip.bvh", HUMANOID, rotations, root, 30.0)
    run(COMMANDS, tmp_path)


MODEL = """
import sys
import numpy as np
import echoavatar
from echoavatar.cli import main
from echoavatar.models.audio import write_wav
from pathlib import Path
sound = 0.1 * np.sin(np.arange(24_000) / 20).astype(np.float32)
write_wav(Path("tone.wav"), sound)
for words in ("animate tone.wav -o tone.glb", "animate tone.wav -o tone.bvh --seed 2", "tools"):
    assert main(words.split()) == 0
    assert "torch" not in sys.modules, words
from echoavatar.cli import doctor
assert {mark for mark, _, _ in doctor._motion()} == {doctor.OK}
from echoavatar.engine import load
from echoavatar.server import ServerSettings, create_app
create_app(load(seats=2), ServerSettings())
import echoavatar.agents.mcp, echoavatar.agents.proxy.relay, echoavatar.cli.camera, echoavatar.cli.say
import echoavatar.server.video.broadcast
assert "torch" not in sys.modules
"""


def test_the_default_bundle_moves_and_is_served_without_it(tmp_path: Path) -> None:
    run(MODEL, tmp_path)


def test_scipy_is_needed_only_where_torch_is() -> None:
    """Both come with one extra."""
    for path in Path(echoavatar.__file__).parent.rglob("*.py"):
        text = path.read_text()
        assert "import scipy" not in text and "from scipy" not in text or "import torch" in text, path
