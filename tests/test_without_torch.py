"""The avatar has no torch, no scipy and no lab: here none of them can be imported."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import echoavatar
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion

ABSENT = ("torch", "scipy", "echoavatar_lab")
WITHOUT = f"import sys\nsys.modules.update(dict.fromkeys({ABSENT}))\n"
EVERY_MODULE = """
import importlib, pkgutil
import echoavatar
from echoavatar.errors import DependencyError
found = 0
for module in pkgutil.walk_packages(echoavatar.__path__, "echoavatar.", onerror=lambda name: None):
    try:
        found += module.name.endswith("__main__") or bool(importlib.import_module(module.name))
    except DependencyError:  # an extra that is not installed here
        pass
    except ModuleNotFoundError as error:
        assert error.name.partition(".")[0] not in ("torch", "scipy", "echoavatar_lab", "echoavatar"), module.name
assert found > 200
"""
COMMANDS = """
from echoavatar.cli import main
for words in (
    "export clip.bvh -o clip.glb",
    "export clip.bvh -o clip.npz",
    "export clip.npz -o other.bvh --rig clip.bvh",
    "rig clip.glb -o body.json",
    "export clip.npz -o own.glb --rig clip.glb",
    "actions add sway clip.bvh",
    "actions list --model my-default",
    "actions remove sway --model my-default",
):
    assert main(words.split()) == 0, words
"""
MODEL = """
import numpy as np
import echoavatar
from echoavatar.cli import main
from echoavatar.models.audio import write_wav
from pathlib import Path
sound = 0.1 * np.sin(np.arange(24_000) / 20).astype(np.float32)
write_wav(Path("tone.wav"), sound)
for words in ("animate tone.wav -o tone.glb", "animate tone.wav -o tone.bvh --seed 2", "tools"):
    assert main(words.split()) == 0, words
from echoavatar.cli import doctor
assert {mark for mark, _, _ in doctor._motion()} == {doctor.OK}
assert [mark for mark, _, _ in doctor._torch()] == [doctor.OPTIONAL]
from echoavatar.bench.stream import bench_stream
from echoavatar.engine import load
from echoavatar.engine.pipeline import Pipeline, load_bundle
assert bench_stream(Pipeline(load_bundle(), device="auto"), seconds=0.5).summary["seconds"] > 0
from echoavatar.server import ServerSettings, create_app
create_app(load(seats=2), ServerSettings())
"""
LACKS_THE_LAB = """
from echoavatar.cli import main
raise SystemExit(main({words!r}.split()))
"""


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", WITHOUT + code], cwd=folder, capture_output=True, text=True)


def done(code: str, folder: Path) -> None:
    ended = run(code, folder)
    assert ended.returncode == 0, ended.stderr


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """A second of standing."""
    still = Motion.at_rest(HUMANOID)
    rotations, root = np.repeat(still.rotations, 30, 0), np.repeat(still.root, 30, 0)
    write_bvh(tmp_path / "clip.bvh", HUMANOID, rotations, root, 30.0)
    return tmp_path


def test_every_module_loads(tmp_path: Path) -> None:
    done(EVERY_MODULE, tmp_path)


def test_recordings_are_written_and_put_on_a_character_and_actions_are_made(clip: Path) -> None:
    done(COMMANDS, clip)


def test_the_default_bundle_moves_and_is_served(tmp_path: Path) -> None:
    done(MODEL, tmp_path)


@pytest.mark.parametrize(
    "words", ["bench stream --size paper", "bench stream --device cuda", "refine-fingers a.bvh b.bvh"]
)
def test_what_needs_the_lab_says_so_in_one_line(words: str, tmp_path: Path) -> None:
    ended = run(LACKS_THE_LAB.format(words=words), tmp_path)
    assert ended.returncode == 1
    assert ended.stderr.count("\n") == 1
    assert "pip install ./lab" in ended.stderr


def test_no_file_names_them_but_the_door() -> None:
    """Neither as an import, wherever in the file, nor as a string to be imported."""
    doors = set()
    for path in Path(echoavatar.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                named = {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                named = {node.module or ""}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
                named = {node.value}
            else:
                continue
            if {name.partition(".")[0] for name in named} & set(ABSENT):
                doors.add(path.name)
    assert doors == {"torch_backend.py", "doctor.py"}, "doctor tells what is installed"
