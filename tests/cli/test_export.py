from pathlib import Path

import pytest
from tests.files.exports.bodies import make_rigs

from echoavatar.cli import main
from echoavatar.motion.formats import read_bvh


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
