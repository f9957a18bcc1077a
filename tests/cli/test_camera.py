"""`echoavatar camera` at a real server, into a file."""

import os
import signal
import socket
import subprocess
import sys
import time
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


@pytest.mark.skipif(os.name != "posix", reason="Windows has no SIGINT for a single process")
def test_ctrl_c_ends_a_stream_to_a_silent_server_at_once() -> None:
    """And the key of the stream is never printed, neither at the start nor in the error."""
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        silent.settimeout(60)
        address = f"rtmp://127.0.0.1:{silent.getsockname()[1]}/live2/very-secret-key"
        code = (  # shells ignore SIGINT for what they run in the background
            "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "from echoavatar.cli import main; sys.exit(main(sys.argv[1:]))"
        )
        words = [sys.executable, "-c", code]
        words += ["camera", "-vv", "--size", "96x64", "--to", address]
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as camera:
            line, _ = silent.accept()
            with line:
                time.sleep(0.3)
                began = time.monotonic()
                camera.send_signal(signal.SIGINT)
                assert camera.stdout is not None
                first = camera.stdout.readline()
                seconds = time.monotonic() - began
                rest, _ = camera.communicate(timeout=30)
    assert first == "echoavatar: interrupted\n"
    assert seconds < 3, "it would wait 10 s for the server, and FFmpeg for ever"
    assert camera.returncode == 130
    assert "very-secret" not in rest


def test_the_line_at_the_start_does_not_show_the_key(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("echoavatar.server.video.broadcast._Distant", lambda *_: None)
    monkeypatch.setattr("echoavatar.server.video.broadcast.Broadcast.close", lambda _: None)
    words = ["--server", "http://me:pass@127.0.0.1:9", "--to", "rtmp://a.example/live2/very-secret-key"]
    assert main(["camera", *words]) == 1
    out, err = capsys.readouterr()
    assert "at rtmp://a.example/...; Ctrl-C stops" in out
    assert "very-secret" not in out + err
    assert "me:pass" not in out + err
