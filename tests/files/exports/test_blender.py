"""What Blender or bpy makes of our files. It starts slowly: the round trips are slow, and skip where there is none."""

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.readers import blender

from echoavatar.errors import DependencyError, MotionError
from echoavatar.files.exports import Take, check_output, read_rig, write_take
from echoavatar.files.exports.blender import find_blender, write_fbx
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import Motion


def test_without_blender_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("BLENDER", str(tmp_path / "no-blender"))
    with pytest.raises(DependencyError, match="no-blender"):
        find_blender()
    with pytest.raises(DependencyError, match=r"pip install --no-deps bpy.*apt-get install blender"):
        check_output(tmp_path / "a.fbx", has_rig=False)


def test_the_package_bpy_takes_the_place_of_the_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A package that has what the script asks for, and writes where it is told to; the name of Blender goes first."""
    (tmp_path / "bpy.py").write_text(
        "from types import SimpleNamespace as N\n"
        "write = lambda filepath, **_: open(filepath, 'w').write('fbx')\n"
        "nothing = lambda **_: None\n"
        "scene = N(render=N(fps=0))\n"
        "ops = N(wm=N(read_factory_settings=nothing), import_scene=N(gltf=nothing), export_scene=N(fbx=write))\n"
        "context, data = N(scene=scene), N(actions=[N(layers=[], frame_range=(0, 1))])\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("BLENDER", raising=False)
    assert find_blender() == [sys.executable]
    write_fbx(tmp_path / "a.fbx", b"", 30)
    assert (tmp_path / "a.fbx").read_text() == "fbx"
    assert "bpy" not in sys.modules  # it ran in a process of its own
    monkeypatch.setenv("BLENDER", str(tmp_path / "no-blender"))
    with pytest.raises(DependencyError, match="no-blender"):
        find_blender()


def test_a_python_that_has_bpy_may_be_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """For a Python that `bpy` is not made for. Blender's own words would be a script to it."""
    for name, words in (("python3.11", 1), ("blender-5.0", 6)):
        (tmp_path / name).touch(0o755)
        monkeypatch.setenv("BLENDER", str(tmp_path / name))
        assert find_blender()[0] == str(tmp_path / name)
        assert len(find_blender()) == words


def test_a_blender_that_fails_is_quoted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "blender"
    broken.write_text("#!/bin/sh\necho Segmentation fault >&2\nexit 11\n")
    broken.chmod(0o755)
    monkeypatch.setenv("BLENDER", str(broken))
    with pytest.raises(MotionError, match="Segmentation fault"):
        write_fbx(tmp_path / "a.fbx", b"", 30)
    assert not (tmp_path / "a.fbx").exists()


def compare(found: dict, motion: Motion, *, offset: int, tolerance: float) -> None:  # type: ignore[type-arg]
    """Bones by name in every frame that was told."""
    places = motion.pose().positions
    assert len(found["frames"]) >= 4
    for frame, heads in found["frames"].items():
        at = min(int(frame) - offset, motion.frames - 1)
        for joint, name in enumerate(motion.skeleton.names):
            np.testing.assert_allclose(heads[name], places[at, joint], atol=tolerance, err_msg=f"{name} {frame}")


@pytest.mark.slow
def test_blender_sees_the_bvh(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["tall"])
    moved = rig.retarget(short)
    write_take(tmp_path / "a.bvh", short, rig=rig)
    found = blender(tmp_path / "a.bvh", picture=tmp_path / "a.png", frames=(1, 13))
    compare(found, moved.motion, offset=1, tolerance=2e-3)
    assert (tmp_path / "a-13.png").stat().st_size > 10_000


@pytest.mark.slow
def test_blender_sees_the_users_character_in_a_glb(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["longarm"])
    moved = rig.retarget(short)
    write_take(tmp_path / "a.glb", short, rig=rig)
    found = blender(tmp_path / "a.glb", picture=tmp_path / "a.png", frames=(12,))
    compare(found, moved.motion, offset=0, tolerance=2e-3)
    assert found["keys"] == ["Basis", "jawOpen"]
    assert (tmp_path / "a-12.png").stat().st_size > 10_000


@pytest.mark.slow
def test_an_fbx_by_blender_comes_back_into_blender(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    try:
        find_blender()
    except DependencyError:
        pytest.skip("needs Blender")
    rig = read_rig(rigs["longarm"])
    moved = rig.retarget(short)
    write_take(tmp_path / "a.fbx", short, rig=rig)
    found = blender(tmp_path / "a.fbx")
    compare(found, moved.motion, offset=found["first"], tolerance=5e-3)


@pytest.mark.slow
def test_an_fbx_by_bpy_has_bones_and_face_in_place(
    monkeypatch: pytest.MonkeyPatch, short: Take, tmp_path: Path
) -> None:
    if find_spec("bpy") is None:
        pytest.skip("needs bpy (pip install --no-deps bpy)")
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("BLENDER", raising=False)
    write_take(tmp_path / "a.fbx", short)
    found, shown = blender(tmp_path / "a.fbx"), short.on_humanoid()
    compare(found, shown.motion, offset=found["first"], tolerance=1e-3)
    assert shown.face is not None
    for frame, values in found["shapes"].items():
        curves = [values[name] for name in ARKIT_NAMES]
        np.testing.assert_allclose(curves, shown.face[int(frame) - found["first"]], atol=1e-3)
