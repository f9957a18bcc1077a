"""`echoavatar say` through a real server."""

import contextlib
import errno
import itertools
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
from tests.agents.client.test_recording import READY, motion
from tests.server.fakes import serving
from tests.server.sinks.receiving import Receiver
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from echoavatar.cli import main
from echoavatar.wire.codec import encode
from echoavatar.wire.messages import Sound


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


def silence(socket: ServerConnection) -> None:
    socket.recv()


def endless_motion(socket: ServerConnection) -> None:
    for at in itertools.count(step=6_400):
        socket.send(encode(motion(at, 0.0)))


def motion_in_one_place(socket: ServerConnection) -> None:
    while True:
        socket.send(encode(motion(0, 0.0)))
        time.sleep(0.02)


def empty_sounds(socket: ServerConnection) -> None:
    for at in itertools.count():
        socket.send(encode(Sound(at=at, epoch=0, seg=0, pcm=b"")))


@pytest.mark.parametrize(
    ("lie", "said"),
    [
        (silence, "made no second of motion in 0.5 s"),
        (motion_in_one_place, "made no second of motion in 0.5 s"),
        (endless_motion, "sends more than this sound needs"),
        (empty_sounds, "sends more than this sound needs"),
    ],
)
def test_a_server_that_never_ends_is_left(
    lie: Callable[[ServerConnection], None],
    said: str,
    talk: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def answer(socket: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            socket.recv()
            socket.send(encode(READY))
            lie(socket)
            time.sleep(3)

    monkeypatch.setattr("echoavatar.cli.say.PATIENCE_S", 0.5)
    monkeypatch.setattr("echoavatar.cli.say.SPARE_S", 1.0)
    with serve(answer, "127.0.0.1", 0, compression=None) as liar:
        thread = threading.Thread(target=liar.serve_forever, daemon=True)
        thread.start()
        address = f"http://127.0.0.1:{liar.socket.getsockname()[1]}"
        assert main(["say", str(talk), "--server", address]) == 1
        liar.shutdown()
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1


def test_sinks_show_the_motion_at_playback_speed(talk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving() as place, Receiver() as receiver:
        assert main(["say", str(talk), "--server", place.address, "--sink", f"json://127.0.0.1:{receiver.port}"]) == 0
        poses = [json.loads(packet) for _, packet in receiver.packets(20)]
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["work_seconds"] > 0.9
    clocks = [pose["clock"] for pose in poses if pose["type"] == "pose"]
    assert clocks == sorted(clocks)
