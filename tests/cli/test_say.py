"""`echoavatar say` through a real server."""

import contextlib
import errno
import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
import soundfile
from tests.agents.client.test_recording import READY, motion, sound
from tests.models.audio.sounds import encode, joined, level_db, tagged, with_sizes
from tests.models.audio.sounds import talk as speech
from tests.server.fakes import serving
from tests.server.sinks.receiving import Receiver
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from echoavatar.cli import main
from echoavatar.models.audio import read_audio
from echoavatar.wire import codec
from echoavatar.wire.messages import Error, Sound, State


@pytest.fixture
def talk(tmp_path: Path) -> Path:
    soundfile.write(tmp_path / "talk.wav", 0.2 * np.sin(np.arange(44_100, dtype=np.float32)), 44_100)
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


def test_it_needs_no_torch(talk: Path) -> None:
    code = "import sys; sys.modules['torch'] = None; from echoavatar.cli import main; sys.exit(main(sys.argv[1:]))"
    with serving() as place:
        words = [sys.executable, "-c", code, "say", str(talk), "--server", place.address]
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["motion_bytes"] > 0


def test_standard_input_is_spoken(
    talk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving() as place, talk.open("rb") as sound:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=sound))
        assert main(["say", "-", "--server", place.address]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["seconds"] == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("name", ["a.bvh", "a.GLB", "a.mp4"])
def test_a_recording_is_not_named_like_another_format(
    name: str, talk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["say", str(talk), "-o", str(tmp_path / name)]) == 1
    assert "`say` writes .npz; `export` turns that into" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["talk.wav"]


def test_bad_sound_is_one_line_to_the_end_of_the_process(tmp_path: Path) -> None:
    """The resampler's library complains at the end of Python about samplers that an error keeps."""
    soundfile.write(tmp_path / "a.wav", np.full(48_000, np.nan), 48_000, subtype="FLOAT")
    code = "import sys; from echoavatar.cli import main; sys.exit(main())"
    words = [sys.executable, "-c", code, "say", str(tmp_path / "a.wav")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "audio sample 0 (0.000 s) is nan" in line


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
        socket.send(codec.encode(motion(at, 0.0)))


def motion_in_one_place(socket: ServerConnection) -> None:
    while True:
        socket.send(codec.encode(motion(0, 0.0)))
        time.sleep(0.02)


def empty_sounds(socket: ServerConnection) -> None:
    for at in itertools.count():
        socket.send(codec.encode(Sound(at=at, epoch=0, seg=0, pcm=b"")))


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
    left = threading.Event()

    def answer(socket: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            socket.recv()
            socket.send(codec.encode(READY))
            lie(socket)
            left.wait(3)

    monkeypatch.setattr("echoavatar.cli.say.PATIENCE_S", 0.5)
    monkeypatch.setattr("echoavatar.cli.say.SPARE_S", 1.0)
    with answering(answer) as address:
        began = time.monotonic()
        assert main(["say", str(talk), "--server", address]) == 1
        assert time.monotonic() - began < 8, "what was not read yet holds nobody up"
        left.set()
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1


@contextlib.contextmanager
def answering(answer: Callable[[ServerConnection], None]) -> Iterator[str]:
    """The address of a server that gives this answer to hello and closes."""
    with serve(answer, "127.0.0.1", 0, compression=None) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()


def test_an_error_that_is_not_fatal_is_told_and_the_recording_goes_on(
    talk: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    def answer(socket: ServerConnection) -> None:
        socket.recv()
        warning = Error(code="internal", message="the engine was restarted", fatal=False, retry_after=0.0)
        end = State(state="idle", at=6_400, seg=0, finished=1)
        for message in (READY, warning, motion(0, 0.0), sound(0, 0.5, seg=1), end):
            socket.send(codec.encode(message))
        with contextlib.suppress(ConnectionClosed):
            while True:
                socket.recv(timeout=5)

    with answering(answer) as address:
        assert main(["say", str(talk), "--server", address, "-o", str(tmp_path / "a.npz")]) == 0
    assert "the server says: the engine was restarted" in caplog.text
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["seconds"] == pytest.approx(8 / 30, abs=1e-3)


def test_sinks_show_the_motion_at_playback_speed(talk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with serving() as place, Receiver() as receiver:
        assert main(["say", str(talk), "--server", place.address, "--sink", f"json://127.0.0.1:{receiver.port}"]) == 0
        poses = [json.loads(packet) for _, packet in receiver.packets(20)]
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["work_seconds"] > 0.9
    clocks = [pose["clock"] for pose in poses if pose["type"] == "pose"]
    assert clocks == sorted(clocks)


def wav(path: Path, channels: np.ndarray, rate: int = 24_000, subtype: str = "PCM_16") -> Path:
    soundfile.write(path, channels, rate, format="WAV", subtype=subtype)
    return path


def two_rates(folder: Path) -> Path:
    first = encode(folder / "1.mp3", "libmp3lame", speech(44_100, 1), 44_100)
    both = np.stack([speech(48_000, 1)] * 2, 1)
    return joined(folder / "a.mp3", first, encode(folder / "2.mp3", "libmp3lame", both, 48_000, layout="stereo"))


def chain(folder: Path) -> Path:
    for name in "12":
        soundfile.write(folder / f"{name}.ogg", speech(24_000, 1), 24_000)
    return joined(folder / "a.ogg", folder / "1.ogg", folder / "2.ogg")


KINDS: dict[str, Callable[[Path], Path]] = {
    "AAC": lambda folder: encode(folder / "a.aac", "aac", speech(44_100), 44_100, container="adts"),
    "M4A": lambda folder: encode(folder / "a.m4a", "aac", speech(44_100), 44_100, container="mp4"),
    "WebM": lambda folder: encode(folder / "a.webm", "libopus", speech(48_000), 48_000),
    "two rates in one MP3": two_rates,
    "chained Ogg": chain,
    "WAV of size 0": lambda folder: with_sizes(wav(folder / "a.wav", speech(24_000)), 0, 0),
    "WAV of size -1": lambda folder: with_sizes(wav(folder / "a.wav", speech(24_000)), 0xFFFFFFFF, 0xFFFFFFFF),
    "a name with a colon": lambda folder: wav(folder / "10:30.WAV", speech(24_000)),
    "a cover in front": lambda folder: tagged(wav(folder / "a.wav", speech(24_000)), 500_000),
    "opposed channels": lambda folder: wav(folder / "a.wav", np.stack([speech(24_000), -speech(24_000)], 1)),
    "a silent first track": lambda folder: encode(
        folder / "a.mp4", "aac", [0 * speech(48_000), speech(48_000)], 48_000
    ),
    "telephone": lambda folder: wav(folder / "a.wav", speech(8_000), 8_000, "ALAW"),
    "louder than 1": lambda folder: wav(folder / "a.wav", 10 * speech(24_000), subtype="FLOAT"),
    "192 kHz": lambda folder: wav(folder / "a", speech(192_000), 192_000, "PCM_24"),
}


def test_say_hears_what_animate_hears(tmp_path: Path) -> None:
    """The same files by the one reader: all of each, at the same level."""
    with serving(seats=2) as place:
        for kind, make in KINDS.items():
            folder = tmp_path / kind
            folder.mkdir()
            path = make(folder)
            assert main(["say", str(path), "--server", place.address, "-o", str(folder / "say.npz"), "-q"]) == 0, kind
            with np.load(folder / "say.npz") as saved:
                said = saved["audio"]
            wanted = read_audio(path)
            energy = np.sum(np.square(np.clip(wanted, -1, 1), dtype=np.float64))
            assert np.sum(np.square(said, dtype=np.float64)) == pytest.approx(energy, rel=0.02), kind
            assert len(wanted) / 24_000 == pytest.approx(2, abs=0.15), kind
            assert level_db(wanted) > -20, kind


@pytest.mark.parametrize("what", ["nan", "text", "film without sound"])
def test_say_refuses_what_animate_refuses(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.wav"
    if what == "nan":
        wav(path, np.array([0.0, np.nan, 0.5], np.float32), subtype="FLOAT")
    elif what == "text":
        path.write_text("not found")
    else:
        with av.open(str(path), "w", format="mp4") as film:
            stream = film.add_stream("mpeg4", rate=30)
            stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
            frame = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
            film.mux([*stream.encode(frame), *stream.encode(None)])
    told = []
    for words in (["say", str(path)], ["animate", str(path), "-o", str(tmp_path / "a.npz")]):
        assert main(words) == 1
        told.append(capsys.readouterr().err)
    assert told[0] == told[1]
    assert {"nan": "sample 1 ", "text": "but text", "film without sound": "no sound track"}[what] in told[0]
    assert told[0].count("\n") == 1
