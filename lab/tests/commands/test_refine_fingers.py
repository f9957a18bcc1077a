from pathlib import Path

import numpy as np
import pytest
from lab.tests.models.fingers.moving import TINY, waving, without

from echoavatar.cli import main
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.kinematics.upright import Stand
from echoavatar_lab.models.fingers.model import FingerModel


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A captured body with flat hands."""
    path = tmp_path_factory.mktemp("take") / "take.bvh"
    motion = waving(40, still=("left", "right"))
    write_bvh(path, motion.skeleton, motion.rotations, motion.root, motion.fps)
    return path


def test_fingers_are_made_by_the_shipped_model_and_the_body_stays(
    take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.bvh"
    assert main(["refine-fingers", str(take), str(out)]) == 0
    assert "40 frames, both hands (frozen before: left, right)" in capsys.readouterr().out
    before, after = read_bvh(take), read_bvh(out)
    assert after.skeleton.names == before.skeleton.names
    changed = [
        name
        for joint, name in enumerate(before.skeleton.names)
        if np.abs(after.rotations[:, joint] - before.rotations[:, joint]).max() > 1e-4
    ]
    assert len(changed) == 30
    assert all(any(digit in name for digit in ("Thumb", "Index", "Middle", "Ring", "Little")) for name in changed)
    np.testing.assert_allclose(after.root, before.root, atol=1e-5)


def test_unit_and_axes_of_the_file_stay(tmp_path: Path) -> None:
    FingerModel(TINY).save(tmp_path / "own", {"data": "none"})
    motion, z_up = waving(10), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    path = tmp_path / "a.bvh"
    write_bvh(path, motion.skeleton, motion.rotations, motion.root, 30, stand=Stand(z_up, z_up, 1.0))
    assert main(["refine-fingers", str(path), str(tmp_path / "o.bvh"), "--model", str(tmp_path / "own")]) == 0
    given, made = path.read_text(), (tmp_path / "o.bvh").read_text()
    assert given.split("MOTION")[0] == made.split("MOTION")[0]
    ours, theirs = (np.array(text.split("MOTION")[1].split()[5:8], np.float64) for text in (given, made))
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def test_a_custom_model_and_one_hand(take: Path, tmp_path: Path) -> None:
    FingerModel(TINY).save(tmp_path / "own", {"data": "none"})
    words = ["--model", str(tmp_path / "own"), "--hands", "left"]
    assert main(["refine-fingers", str(take), str(tmp_path / "o.bvh"), *words]) == 0
    before, after = read_bvh(take), read_bvh(tmp_path / "o.bvh")
    right = [i for i, name in enumerate(before.skeleton.names) if name.startswith("right")]
    np.testing.assert_allclose(after.rotations[:, right], before.rotations[:, right], atol=1e-4)


def test_errors_are_one_line(take: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = without(waving(10), "Thumb", "Index", "Middle", "Ring", "Little")
    write_bvh(tmp_path / "bare.bvh", bare.skeleton, bare.rotations, bare.root, 30)
    cases = [
        ([str(tmp_path / "bare.bvh"), str(tmp_path / "o.bvh")], "no finger bones"),
        ([str(tmp_path / "none.bvh"), str(tmp_path / "o.bvh")], "does not exist"),
        ([str(take), str(tmp_path / "o.fbx")], "the output must be BVH"),
        ([str(take), str(tmp_path / "no" / "o.bvh")], "cannot write"),
        ([str(take), str(tmp_path / "o.bvh"), "--model", str(tmp_path)], "is not a checkpoint"),
    ]
    for words, complaint in cases:
        assert main(["refine-fingers", *words]) == 1
        [line] = [text for text in capsys.readouterr().err.splitlines() if text.startswith("echoavatar:")]
        assert complaint in line
