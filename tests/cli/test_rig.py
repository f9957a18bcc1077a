from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.files.avatar import load_character
from echoavatar.files.avatar.gltf import pack_glb
from echoavatar.motion.ik import BodyProfile


def test_a_character_is_measured_and_the_profile_can_be_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    glb, profile = tmp_path / "character.glb", tmp_path / "body.json"
    glb.write_bytes(pack_glb(load_character(), []))
    assert main(["rig", str(glb), "-o", str(profile)]) == 0
    assert [part.bone for part in BodyProfile.load(profile).parts][0] == "hips"
    assert "6 parts" in capsys.readouterr().out


def test_what_cannot_be_read_or_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", str(tmp_path / "none.glb"), "-o", str(tmp_path / "x.json")]) == 1
    assert "check the name" in capsys.readouterr().err
    assert main(["rig", str(tmp_path / "none.glb"), "-o", str(tmp_path / "no" / "x.json")]) == 1
    assert "make it first" in capsys.readouterr().err
