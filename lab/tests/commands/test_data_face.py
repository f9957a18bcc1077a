from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.cli import main
from echoavatar.motion.arkit import LIVE_LINK_NAMES
from echoavatar_lab.models.face.clip import load_clips


def take(folder: Path, name: str, frames: int = 60, columns: tuple[str, ...] = LIVE_LINK_NAMES) -> Path:
    header = ["Timecode", "BlendshapeCount", *(column[:1].upper() + column[1:] for column in columns)]
    rows = [
        [f"00:00:{n // 60:02d}:{n % 60:02d}.000", "61", *(f"{0.01 * (n % 50):.3f}" for _ in columns)]
        for n in range(frames)
    ]
    path = folder / f"{name}.csv"
    path.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    return path


def sound(folder: Path, name: str, seconds: float = 1.0) -> None:
    soundfile.write(folder / f"{name}.wav", 0.1 * np.ones(int(24_000 * seconds), np.float32), 24_000)


def test_takes_of_a_folder_become_clips_and_bad_ones_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    take(tmp_path, "good")
    sound(tmp_path, "good")
    take(tmp_path, "mute")
    take(tmp_path, "narrow", columns=LIVE_LINK_NAMES[:20])
    sound(tmp_path, "narrow")
    assert main(["data", "face", str(tmp_path), "-o", str(tmp_path / "faces"), "--timecode", "60"]) == 1
    said = capsys.readouterr().err
    assert "mute.csv: no sound" in said
    assert "narrow.csv" in said
    assert "no column for" in said
    (clip,) = load_clips(tmp_path / "faces")
    assert clip.name == "good"
    assert clip.curves.shape == (30, 52)


def test_either_takes_or_a_rehearsal(capsys: pytest.CaptureFixture[str]):
    assert main(["data", "face"]) == 1
    assert "--rehearse" in capsys.readouterr().err
