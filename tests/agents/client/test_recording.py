from pathlib import Path
from typing import Any

import numpy as np
import pytest

from echoavatar.agents.client import Recorder, Recording
from echoavatar.errors import MotionError
from echoavatar.wire.blobs import Pose, pack_audio, pack_pose
from echoavatar.wire.messages import Flush, Latency, Limits, Motion, Ready, Rig, Sound, State

READY = Ready(
    version=1, server="", session="", resume="", resumed=False, at=0, epoch=0, seg=0, received=0,
    sample_rate=24_000, frame_rate=30, chunk_samples=6_400,
    rig=Rig(names=("hips", "head"), parents=(-1, 0), rest=((0.0, 1.0, 0.0), (0.0, 0.5, 0.0))),
    face=("jawOpen",), actions=(), tracks=(), latency=Latency(algorithm=0, compute=0), limits=Limits(),
)  # fmt: skip


def motion(at: int, height: float) -> Motion:
    turns = np.zeros((8, 2, 4), np.float32)
    turns[..., 0] = 1
    return pack_pose(Pose(turns, np.full((8, 3), height, np.float32), np.full((8, 1), 0.5, np.float32)), at=at)


def sound(at: int, level: float, seg: int = 0) -> Sound:
    return Sound(at=at, epoch=0, seg=seg, pcm=pack_audio(np.full(6_400, level, np.float32)))


def test_an_utterance_is_cut_out_of_the_session(tmp_path: Path) -> None:
    recorder = Recorder(READY)
    for message in (
        motion(0, 0),
        sound(0, 0),
        motion(6_400, 1),
        sound(6_400, 0.5, 1),
        motion(12_800, 2),
        sound(12_800, 0.5, 1),
    ):
        recorder.take(message)
    assert not recorder.has(1)
    recorder.take(State(state="idle", at=16_000, seg=0, finished=1))
    assert recorder.has(1)
    recording = recorder.recording(1)
    assert recording.root[:, 0].tolist() == [1] * 8 + [2] * 4
    assert len(recording.audio) == 12 * 800
    assert recording.seconds == pytest.approx(0.4)
    recording.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as saved:
        assert saved["rotations"].shape == (12, 2, 4)
        assert saved["face_names"].tolist() == ["jawOpen"]
        assert int(saved["frame_rate"]) == 30


def test_a_recording_leaves_out_what_was_flushed() -> None:
    recorder = Recorder(READY)
    for message in (motion(0, 0), sound(0, 0.5), motion(6_400, 1), sound(6_400, 0.5)):
        recorder.take(message)
    recorder.take(Flush(at=8_000, epoch=1, seg=1, heard=1_600))
    recorder.take(motion(8_000, 3))
    recording = recorder.recording()
    assert recording.root[:, 0].tolist() == [0] * 8 + [1] * 2 + [3] * 8
    assert not recording.audio[8_000:].any()


def test_a_recording_without_motion_is_an_error() -> None:
    with pytest.raises(MotionError):
        Recorder(READY).recording()


def test_a_recording_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(file: Any, **_: object) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", fill)
    none = np.zeros(0, np.float32)
    with pytest.raises(MotionError, match="No space left"):
        Recording((), (), none.reshape(0, 0, 4), none.reshape(0, 3), none.reshape(0, 0), none).save(tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []
