from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import AudioError, EchoAvatarError
from echoavatar.models.audio.io import write_wav
from echoavatar_lab.datasets import music_sources
from echoavatar_lab.datasets.music_sources import composed_music, recorded_music


def clicks(seconds: float, bpm: float = 120) -> np.ndarray:
    time = np.arange(round(seconds * 24_000)) / 24_000
    phase = time % (60 / bpm)
    return (0.5 * np.sin(2 * np.pi * 220 * time) * np.exp(-phase * 20)).astype(np.float32)


def test_composed_pieces_know_their_beats_and_go_through_the_styles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(music_sources, "COMPOSED_SECONDS", (5.0, 6.0))
    first, second = islice(composed_music(1), 2)
    take, again = first.make(), first.make()
    np.testing.assert_array_equal(take.audio, again.audio)
    assert take.notes["style"] != second.make().notes["style"]
    assert take.licence == "Apache-2.0"
    assert len(take.audio) == 800 * len(take.domain)
    np.testing.assert_allclose(np.median(np.diff(take.events["beats"])), 60 / float(take.notes["bpm"]), rtol=0.06)
    assert [job.split for job in islice(composed_music(1), 10)].count("test") == 1


def test_files_are_read_by_path_with_beats_measured(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    write_wav(tmp_path / "b/Höhe 1.wav", clicks(12), rate=24_000)
    write_wav(tmp_path / "a.wav", clicks(1), rate=24_000)
    short, piece = recorded_music(tmp_path, "CC0")
    assert piece.name.endswith("-H-he-1")
    take = piece.make()
    assert take.licence == "CC0"
    assert take.source.startswith("b/Höhe 1.wav, SHA-256 ")
    assert abs(np.median(np.diff(take.events["beats"])) - 0.5) < 0.02
    with pytest.raises(AudioError, match=r"a\.wav is shorter than 4 s"):
        short.make()


def test_long_files_are_cut_and_silent_ones_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(music_sources, "LONGEST_SECONDS", 5.0)
    write_wav(tmp_path / "long.wav", clicks(12))
    write_wav(tmp_path / "mute.wav", np.zeros(24_000 * 5, np.float32))
    long, mute = recorded_music(tmp_path, "")
    take = long.make()
    assert 5 <= len(take.audio) / 24_000 < 6
    assert take.notes["cut"].startswith("after 5")
    with pytest.raises(AudioError, match=r"mute\.wav is silent"):
        mute.make()


def test_a_folder_without_music_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="holds no sound"):
        next(recorded_music(tmp_path, ""))
