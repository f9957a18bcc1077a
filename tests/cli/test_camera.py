"""`echoavatar camera` at a real server, into a file."""

import sys
from pathlib import Path

import av
import numpy as np
import pytest
from tests.server.fakes import serving
from tests.server.video.flashes import Flasher, beeps

from echoavatar.cli import main
from echoavatar.wire.messages import Hello


def test_a_session_is_recorded_with_its_sound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.flv"
    with serving(pipeline=Flasher()) as server, server.call(Hello(want=())) as caller:
        caller.speak(1, beeps(3))
        words = ["--server", f"http://{server.address}", "--to", str(path), "--size", "96x64", "--seconds", "3"]
        assert main(["camera", *words]) == 0
    assert "pictures" in capsys.readouterr().err
    with av.open(str(path)) as container:
        frames = list(container.decode())
    pictures = [frame for frame in frames if isinstance(frame, av.VideoFrame)]
    sound = np.concatenate([frame.to_ndarray()[0] for frame in frames if isinstance(frame, av.AudioFrame)])
    assert (pictures[0].width, pictures[0].height) == (96, 64)
    assert len(sound) / 48_000 == pytest.approx(3, abs=0.5)
    assert np.abs(sound).max() > 0.2


def test_errors_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for missing in ("pyvirtualcam", "moderngl"):
        monkeypatch.setitem(sys.modules, missing, None)
    for words, reason in (
        ([], "pyvirtualcam"),
        (["--to", "a.avi"], "neither rtmp"),
        (["--to", str(tmp_path / "a.flv"), "--server", "http://127.0.0.1:9"], "echoavatar serve"),
        (["--to", str(tmp_path / "a.flv"), "--size", "32x32"], "64x64"),
        (["--renderer", "gpu"], "echoavatar[gpu]"),
    ):
        assert main(["camera", *words]) == 1
        told = capsys.readouterr().err.strip().splitlines()
        assert reason in told[-1]
