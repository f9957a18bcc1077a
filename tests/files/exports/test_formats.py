import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.files.exports import SUFFIXES, Take, check_output, read_rig, read_take, write_take
from echoavatar.motion.formats import read_bvh
from echoavatar.motion.kinematics.rigs import bone_map


@pytest.mark.parametrize(
    ("name", "has_rig", "complaint"),
    [
        ("a.xyz", False, "use one of .bvh"),
        ("no/such/a.bvh", False, "make it first"),
        ("a.usdc", True, "leave --rig out"),
        ("a.smplx.npz", True, "leave --rig out"),
        ("a.vrm", False, "name it with --rig"),
    ],
)
def test_what_cannot_be_written_is_said_before_any_work(
    tmp_path: Path, name: str, has_rig: bool, complaint: str
) -> None:
    with pytest.raises(EchoAvatarError, match=complaint):
        check_output(tmp_path / name, has_rig=has_rig)


def test_every_format_of_ours_is_written(short: Take, tmp_path: Path) -> None:
    few = Take(short.motion.cut(0, 4), short.face[:4])  # type: ignore[index]
    others = (".vrm", ".fbx", ".mp4", ".usda", ".usdc", ".usdz")
    for suffix in (*(s for s in SUFFIXES if s not in others), ".smplx.npz"):
        path = tmp_path / f"a{suffix}"
        write_take(path, few)
        assert path.stat().st_size > 500, suffix
    assert (tmp_path / "a.face.csv").exists()


@pytest.mark.parametrize("rate", [24000 / 1001, 30000 / 1001, 60000 / 1001])
def test_every_format_keeps_the_true_rate(rate: float, short: Take, tmp_path: Path) -> None:
    """Frame k stands at second k / rate, in whatever way a format says so."""
    few = Take(replace(short.motion.cut(0, 40), fps=rate), short.face[:40])  # type: ignore[index]
    for ending in (".bvh", ".npz", ".csv", ".glb", ".vrma", ".smplx.npz"):
        write_take(tmp_path / f"a{ending}", few)
    for name in ("a.bvh", "a.npz", "a.smplx.npz"):
        assert read_take(tmp_path / name).motion.fps == pytest.approx(rate, rel=1e-12)
    last = (tmp_path / "a.csv").read_text().splitlines()[-1].split(",")[0]
    assert float(last) == pytest.approx(39 / rate, abs=1e-6)
    _, _, seconds, frames = (tmp_path / "a.face.csv").read_text().splitlines()[-1].split(",")[0].split(":")
    assert int(seconds) + float(frames) / (60 if rate > 30 else 30) == pytest.approx(39 / rate, abs=1e-4)
    for name in ("a.glb", "a.vrma"):
        data = (tmp_path / name).read_bytes()
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        clock = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
        assert clock["max"] == pytest.approx([39 / rate], abs=1e-6)


def test_a_bvh_of_a_rig_has_its_bones_in_its_own_unit(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["tall"])
    moved, path = rig.retarget(short), tmp_path / "a.bvh"
    write_take(path, short, rig=rig)
    read = read_bvh(path)
    assert read.skeleton.names == read_bvh(rigs["tall"]).skeleton.names
    np.testing.assert_allclose(read.pose().positions, moved.motion.pose().positions, atol=2e-5)
    low = read.pose().positions[:, bone_map(read.skeleton)["leftToes"], 1].min()
    assert low > -1e-6  # over the floor, though the rig's own rest pose lies below it


def test_a_skeleton_has_no_mesh_for_a_glb(rigs, short: Take, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    rig = read_rig(rigs["tall"])
    with pytest.raises(EchoAvatarError, match="no mesh"):
        write_take(tmp_path / "a.glb", short, rig=rig)


def test_a_take_without_a_face_has_no_face_file(short: Take, tmp_path: Path) -> None:
    for name in ("a.face.csv", "a.face47.csv"):
        with pytest.raises(EchoAvatarError, match="no face"):
            write_take(tmp_path / name, Take(short.motion))
