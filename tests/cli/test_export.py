import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.files.exports.bodies import make_rigs
from tests.motion.kinematics.samples import swaying

from echoavatar.cli import main
from echoavatar.files.exports import read_take
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.upright import OURS, Stand


def test_a_recording_becomes_a_file(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(recording), "-o", str(tmp_path / "a.vrma")]) == 0
    assert "12 frames at 30 fps" in capsys.readouterr().out
    assert (tmp_path / "a.vrma").read_bytes()[:4] == b"glTF"


def test_a_recording_goes_onto_a_rig(recording: Path, tmp_path: Path) -> None:
    rigs = make_rigs(tmp_path)
    assert main(["export", str(recording), "-o", str(tmp_path / "a.bvh"), "--rig", str(rigs["tall"])]) == 0
    assert read_bvh(tmp_path / "a.bvh").skeleton.names[0] == "mixamorig:Hips"
    assert main(["export", str(recording), "-o", str(tmp_path / "a.vrm"), "--rig", str(rigs["child"])]) == 0


def test_errors_are_one_line(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (
        [str(recording), "-o", str(tmp_path / "a.xyz")],
        [str(recording), "-o", str(tmp_path / "a.glb"), "--rig", str(tmp_path / "none.vrm")],
        [str(tmp_path / "none.npz"), "-o", str(tmp_path / "a.glb")],
    ):
        assert main(["export", *words]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_the_recording_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.bvh"
    path.write_text("HIERARCHY")
    assert main(["export", str(path), "-o", str(tmp_path / "." / "x.bvh")]) == 1
    assert "is the recording itself" in capsys.readouterr().err
    assert path.read_text() == "HIERARCHY"


Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
FRAMES = 40


def clip(path: Path, stand: Stand, fps: float = 30.0) -> str:
    made = swaying(FRAMES)
    write_bvh(path, HUMANOID, made.rotations, made.root, fps, stand=stand)
    return path.read_text()


FIELD: dict[str, tuple[Stand, Callable[[str], str | bytes], float, str]] = {  # file, rate that is meant, what is said
    "metres": (Stand(metres=1.0), str, 30, "its unit is taken for metres"),
    "millimetres": (Stand(metres=0.001), str, 30, "its unit is taken for millimetres"),
    "Z up": (Stand(Z_UP, Z_UP), str, 30, "it is turned to Y up"),
    "the motion alone Z up": (Stand(np.eye(3), Z_UP), str, 30, "its motion is turned to Y up"),
    "one row more than the header says": (
        Stand(),
        lambda t: t.replace("Frames: 40", "Frames: 39"),
        30,
        "says 39 frames",
    ),
    "29.97": (OURS, lambda t: re.sub("Time: .*", "Time: 0.0333667", t), 30000 / 1001, ""),
    "59.94": (OURS, lambda t: re.sub("Time: .*", "Time: 0.0166833", t), 60000 / 1001, ""),
    "23.976": (OURS, lambda t: re.sub("Time: .*", "Time: 0.0417083", t), 24000 / 1001, ""),
    "Shift-JIS": (OURS, lambda t: t.replace("spine\n", "背骨\n").encode("shift_jis"), 30, "taken for shift_jis"),
    "GBK": (OURS, lambda t: t.replace("spine\n", "脊柱\n").encode("gbk"), 30, "taken for gb2312"),
    "Latin-1": (OURS, lambda t: t.replace("spine\n", "colonne_é\n").encode("latin-1"), 30, "taken for cp1252"),
    "a brace on the line": (OURS, lambda t: t.replace("ROOT hips\n{", "ROOT hips {"), 30, ""),
}


@pytest.mark.parametrize("kind", FIELD)
def test_a_clip_of_any_program_is_the_same_motion(kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As a table, and on another rig."""
    stand, change, rate, said = FIELD[kind]
    clip(tmp_path / "plain.bvh", OURS, rate)
    text = change(clip(tmp_path / "odd.bvh", stand))
    (tmp_path / "odd.bvh").write_bytes(text if isinstance(text, bytes) else text.encode())
    rig = make_rigs(tmp_path)["tall"]
    for words, suffix in (([], ".npz"), (["--rig", str(rig)], ".bvh")):
        made: list[Motion] = []
        for name in ("plain", "odd"):
            place = tmp_path / f"{name}.out{suffix}"
            assert main(["export", str(tmp_path / f"{name}.bvh"), "-o", str(place), *words]) == 0
            assert name == "plain" or said in caplog.text
            assert bool(caplog.text) == (name == "odd" and said != "")
            caplog.clear()
            made.append(read_take(place).motion)
        assert [motion.fps for motion in made] == [rate, rate]
        places = [motion.pose(np.float64).positions for motion in made]
        np.testing.assert_allclose(places[1], places[0], atol=1e-3, rtol=0)
        assert float(places[1][:, made[1].skeleton.index(made[1].skeleton.names[0]), 1].min()) > 0.8
