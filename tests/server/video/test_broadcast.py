"""Files and RTMP by FFmpeg, and a virtual camera where there is one."""

import contextlib
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.server.video import Block, Picture
from echoavatar.server.video.broadcast import Broadcast, VirtualCamera, container_of
from echoavatar.server.video.live_stream import BLOCK_SAMPLES, EDGE

SIZE = (64, 64)


def perform(output: Any, seconds: int = 2) -> None:
    """A white picture and a tone in each second's first half, black and silence in the other."""
    for block in range(50 * seconds):
        is_on = block % 50 < 25
        if block % 2 == 0:
            pixels = np.full((SIZE[1], SIZE[0], 3), 255 * is_on, np.uint8)
            output.show(Picture(block / 50, pixels))
        tone = 9_000 * np.sin(np.arange(BLOCK_SAMPLES + 2 * EDGE) / 4) * is_on
        output.hear(Block(block / 50, tone.astype(np.int16)))


def edges(path: str, **options: Any) -> tuple[float, float]:
    """When picture and sound go off for the first time, in seconds."""
    with av.open(path, **options) as container:
        light, loud = [], []
        with contextlib.suppress(av.error.OSError):  # so FFmpeg's listener says that the sender hung up
            for frame in container.decode():
                if isinstance(frame, av.VideoFrame):
                    light.append((frame.time, frame.to_ndarray(format="gray").mean() > 128))
                elif isinstance(frame, av.AudioFrame):
                    loud.append((frame.time, float(np.abs(frame.to_ndarray()).max()) > 0.1))
    off = [next(b[0] for a, b in zip(part, part[1:], strict=False) if a[1] and not b[1]) for part in (light, loud)]
    return off[0], off[1]


@pytest.mark.parametrize("name", ["a.flv", "a.mp4", "10:30.mkv", "a.ts"])
def test_a_file_has_picture_and_sound_in_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    output = Broadcast(name, SIZE, 25)
    perform(output)
    output.close()
    picture, sound = edges(f"file:{name}")
    assert abs(picture - sound) < 0.06


def test_an_rtmp_server_gets_the_same() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"rtmp://127.0.0.1:{probe.getsockname()[1]}/live/key"
    seen: list[tuple[float, float]] = []

    def listen() -> None:
        seen.append(edges(address, format="flv", options={"listen": "1"}))

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    output = _opened(address)
    perform(output)
    output.close()
    listener.join(20)
    assert seen
    assert abs(seen[0][0] - seen[0][1]) < 0.06


def _opened(address: str, size: tuple[int, int] = SIZE) -> Broadcast:
    for _ in range(100):
        try:
            return Broadcast(address, size, 25)
        except EchoAvatarError:
            threading.Event().wait(0.1)
    raise AssertionError("the listener never listened")


@pytest.mark.parametrize("to", ["rtmp://127.0.0.1:1/live/key", "/no/such/folder/a.flv"])
def test_where_nothing_can_be_sent_one_line_says_so(to: str) -> None:
    with pytest.raises(EchoAvatarError, match="cannot send to"):
        Broadcast(to, SIZE, 25)


@pytest.mark.parametrize("to", ["http://127.0.0.1/", "a.avi", "rtmp", "file:///etc/passwd.flv"])
def test_other_addresses_are_refused(to: str) -> None:
    with pytest.raises(EchoAvatarError, match="neither rtmp"):
        container_of(to)


def test_a_virtual_camera_gets_the_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[np.ndarray] = []
    device = SimpleNamespace(device="/dev/video9", send=sent.append, close=lambda: sent.append(np.zeros(0)))
    monkeypatch.setitem(sys.modules, "pyvirtualcam", SimpleNamespace(Camera=lambda *_: device))
    camera = VirtualCamera(SIZE, 25)
    perform(camera, 1)
    camera.close()
    assert camera.name == "/dev/video9"
    assert [len(picture) for picture in sent] == [64] * 25 + [0]


def test_without_one_a_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise RuntimeError("no device")

    monkeypatch.setitem(sys.modules, "pyvirtualcam", SimpleNamespace(Camera=none))
    with pytest.raises(DependencyError, match="v4l2loopback"):
        VirtualCamera(SIZE, 25)
    monkeypatch.setitem(sys.modules, "pyvirtualcam", None)
    with pytest.raises(DependencyError, match=r"echoavatar\[camera\]"):
        VirtualCamera(SIZE, 25)


SECRET = "live2/very-secret-stream-key"


@contextlib.contextmanager
def silent_server() -> Iterator[str]:
    """Accepts, and says nothing."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield f"rtmp://127.0.0.1:{server.getsockname()[1]}/{SECRET}"


def test_a_server_that_accepts_and_is_silent_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("echoavatar.server.video.broadcast.OPEN_S", 1.0)
    ticks: list[float] = []

    def tick() -> None:
        for _ in range(40):
            ticks.append(time.monotonic())
            time.sleep(0.02)

    beside = threading.Thread(target=tick)
    beside.start()
    with silent_server() as address:
        began = time.monotonic()
        with pytest.raises(EchoAvatarError, match=r"cannot send to rtmp://127\.0\.0\.1:\d+/\.\.\. \(.*nothing for 1 s"):
            Broadcast(address, SIZE, 25)
        assert time.monotonic() - began < 3
    beside.join()
    assert max(np.diff(ticks)) < 0.5, "FFmpeg would hold all threads up"


def test_a_server_that_stops_reading_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("echoavatar.server.video.broadcast.WRITE_S", 0.5)
    noise = np.random.default_rng(0).integers(0, 256, (720, 1280, 3), np.uint8)
    with _listener() as (address, listener):
        output = _opened(address, (1280, 720))
        listener.send_signal(signal.SIGSTOP)
        with pytest.raises(EchoAvatarError, match=r"cannot send to rtmp://[^ ]+/\.\.\. \(.*nothing for 0.5 s"):
            _show(output, (np.roll(noise, 997 * number, 1) for number in range(100)))  # none follows from another
        with pytest.raises(EchoAvatarError, match="nothing for"):
            output.close()


def _show(output: Broadcast, pictures: Iterable[np.ndarray]) -> None:
    for number, pixels in enumerate(pictures):
        output.show(Picture(float(number), pixels))


@contextlib.contextmanager
def _listener() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A listener by FFmpeg in another process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"rtmp://127.0.0.1:{probe.getsockname()[1]}/{SECRET}"
    program = (
        "import av, sys, time\n"
        "source = av.open(sys.argv[1], format='flv', options={'listen': '1', 'probesize': '32'})\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, address]) as listener:
        try:
            yield address, listener
        finally:
            listener.kill()


@pytest.mark.parametrize(
    "address",
    [
        f"rtmp://127.0.0.1:1/{SECRET}",
        f"rtmp://me:{SECRET}@127.0.0.1:1/x",
        f"rtmps://127.0.0.1:1/{SECRET}",
        f"rtmp://no.such.host.invalid/{SECRET}",
    ],
)
def test_no_error_and_no_log_shows_the_key_of_a_stream(
    address: str, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level(0)
    av.logging.set_level(av.logging.VERBOSE)
    try:
        with pytest.raises(EchoAvatarError, match="cannot send to") as caught:
            Broadcast(address, SIZE, 25)
    finally:
        av.logging.set_level(None)
    shown = "".join(traceback.format_exception(caught.value)) + caplog.text + "".join(capfd.readouterr())
    assert "very-secret" not in shown
