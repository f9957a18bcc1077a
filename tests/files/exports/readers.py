"""Readers that are not ours: Node (three-vrm-animation, Khronos validator, three.js), Blender; absent, tests skip."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from echoavatar.errors import DependencyError
from echoavatar.files.exports.blender import find_blender

ROOT = Path(__file__).parents[3]
WEB = ROOT / "web"
PICTURE = Path(__file__).with_name("blender_picture.py")


def node(script: str, *words: object) -> dict[str, Any]:
    """What a script of web/checks says of a file."""
    names = ("@pixiv/three-vrm-animation", "gltf-validator")
    has_readers = all((WEB / "node_modules" / name).is_dir() for name in names)
    if shutil.which("node") is None or not has_readers:
        pytest.skip("needs Node and `npm ci` in web/")
    done = subprocess.run(
        ["node", f"checks/{script}", *map(str, words)], cwd=WEB, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def blender(source: Path, *, picture: Path | None = None, frames: tuple[int, ...] = ()) -> dict[str, Any]:
    """Where Blender sees the bones, every tenth frame, and pictures of some."""
    try:
        program = find_blender()
    except DependencyError:
        pytest.skip("needs Blender (apt-get install blender python3-numpy, or pip install --no-deps bpy)")
    told = source.with_suffix(".places.json")
    words = [str(source), str(told), *([str(picture)] if picture else []), *map(str, frames)]
    done = subprocess.run([*program, str(PICTURE), "--", *words], capture_output=True, text=True, timeout=600)
    assert told.exists(), (done.stdout + done.stderr)[-2000:]
    found: dict[str, Any] = json.loads(told.read_text())
    return found
