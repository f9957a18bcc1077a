"""`echoavatar say` through a real server."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
from tests.server.fakes import serving
from tests.server.sinks.receiving import Receiver

from echoavatar.cli import main


@pytest.fixture
def talk(tmp_path: Path) -> Path:
    soundfile.write(tmp_path / "talk.wav", np.full(44_100, 0.2, np.float32), 44_100)
    return tmp_path / "talk.wav"


def test_a_file_becomes_motion(talk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving() as place:
        assert main(["say", str(talk), "--server", place.address, "-o", str(tmp_path / "a.npz"), "--act", "wave"]) == 0
        report = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert report["seconds"] == pytest.approx(1.0, abs=0.3)
        with np.load(tmp_path / "a.npz") as saved:
            assert saved["rotations"].shape[1:] == (52, 4)
            assert np.count_nonzero(saved["audio"]) >= 23_900
        assert main(["say", str(talk), "--server", place.address, "--act", "fly"]) == 1
        assert "wave" in capsys.readouterr().err


def test_errors_are_one_line(talk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (
        [str(talk), "--server", "http://127.0.0.1:9"],
        [str(talk), "--server", "ftp://a"],
        [str(talk), "-o", str(tmp_path / "no" / "a.npz")],
        [str(tmp_path / "none.wav")],
    ):
        assert main(["say", *words]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_a_full_disk_is_one_line(
    talk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*args: object, **more: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with serving() as place:
        assert main(["say", str(talk), "--server", place.address, "-o", str(tmp_path / "a.npz")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "No space left" in told
    assert [path.name for path in tmp_path.iterdir()] == ["talk.wav"]


def test_sinks_show_the_motion_at_playback_speed(talk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving() as place, Receiver() as receiver:
        assert main(["say", str(talk), "--server", place.address, "--sink", f"json://127.0.0.1:{receiver.port}"]) == 0
        poses = [json.loads(packet) for _, packet in receiver.packets(20)]
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["work_seconds"] > 0.9
    clocks = [pose["clock"] for pose in poses if pose["type"] == "pose"]
    assert clocks == sorted(clocks)
