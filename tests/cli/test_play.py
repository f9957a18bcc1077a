from pathlib import Path

import pytest
from tests.motion.kinematics.samples import swaying
from tests.server.sinks.receiving import Receiver

from echoavatar.cli import main
from echoavatar.motion.formats import write_bvh


def test_a_recording_goes_to_every_sink(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Receiver() as vmc, Receiver() as face:
        words = ["--sink", f"vmc://127.0.0.1:{vmc.port}", "--sink", f"livelink://127.0.0.1:{face.port}"]
        assert main(["play", str(recording), *words]) == 0
        assert all(packet.startswith(b"#bundle") for _, packet in vmc.packets(6))
        assert len({packet[:41] for _, packet in face.packets(6)}) == 1
    assert "frames shown: " in capsys.readouterr().out


def test_a_clip_of_another_rate_is_played_in_its_own_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = swaying(48, fps=24000 / 1001)
    write_bvh(tmp_path / "film.bvh", clip.skeleton, clip.rotations, clip.root, clip.fps)
    with Receiver() as vmc:
        assert main(["play", str(tmp_path / "film.bvh"), "--sink", f"vmc://127.0.0.1:{vmc.port}"]) == 0
    assert "2.0 s to" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "complaint"), [(["missing.npz"], "does not exist"), ([__file__], "neither .npz nor .bvh")]
)
def test_errors_are_one_line(words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["play", *words, "--sink", "vmc://127.0.0.1"]) == 1
    assert complaint in capsys.readouterr().err


def test_a_bad_address_is_named(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["play", str(recording), "--sink", "nowhere"]) == 1
    assert "no known kind" in capsys.readouterr().err


def test_a_map_is_for_a_bvh(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "map.json").write_text("{}")
    assert main(["play", str(recording), "--sink", "vmc://127.0.0.1", "--map", str(tmp_path / "map.json")]) == 1
    assert "a map is for a BVH or a rig" in capsys.readouterr().err
