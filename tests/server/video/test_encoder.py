"""The program that encodes: what it says, and that it imports nothing of the package."""

import io
import json
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest

from echoavatar.server.video import encoder

SETTINGS = ["flv", [64, 64], 25, 48_000]


def program(written: bytes) -> list[str]:
    words = [sys.executable, "-P", encoder.__file__]
    return subprocess.run(words, input=written, capture_output=True, check=True, timeout=60).stdout.decode().split()


def block(seconds: float, data: np.ndarray) -> bytes:
    told = {"seconds": seconds, "type": data.dtype.str, "shape": data.shape, "bytes": data.nbytes}
    return json.dumps(told).encode() + b"\n" + data.tobytes()


def test_what_comes_is_encoded(tmp_path: Path) -> None:
    path = str(tmp_path / "a.flv")
    written = json.dumps([path, *SETTINGS]).encode() + b"\n"
    for number in range(10):
        written += block(number / 25, np.full((64, 64, 3), 255, np.uint8))
        written += block(number / 25, np.zeros(1920, np.int16))
    assert program(written) == ["open", "closed"]
    with av.open(path) as container:
        frames = list(container.decode())
    assert sum(isinstance(frame, av.VideoFrame) for frame in frames) == 10
    assert sum(isinstance(frame, av.AudioFrame) for frame in frames) > 10


def test_what_fails_is_said_without_the_address() -> None:
    written = json.dumps(["rtmp://127.0.0.1:1/live/very-secret", *SETTINGS]).encode() + b"\n"
    assert program(written) == ["Connection", "refused"]


def test_it_imports_nothing_of_the_package() -> None:
    source = Path(encoder.__file__).read_text("utf-8")
    assert "from echoavatar" not in source
    assert "from ." not in source


def test_ctrl_c_is_left_to_the_other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    ignored: list[tuple[object, ...]] = []
    settings = json.dumps(["/no/such/folder/a.flv", *SETTINGS]).encode()
    monkeypatch.setattr("signal.signal", lambda *each: ignored.append(each))
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(settings)))
    encoder.main()
    assert ignored == [(signal.SIGINT, signal.SIG_IGN)]
