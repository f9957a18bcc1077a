from pathlib import Path

import numpy as np
import pytest

from echoavatar.models.audio import write_wav
from echoavatar_lab.corpora.rehearsal.recorded_sound import RecordedSound
from echoavatar_lab.corpora.rehearsal.track import compose_track

pytestmark = pytest.mark.usefixtures("own_cache")


def folder(path: Path) -> RecordedSound:
    """Nine women, a man, and a click every half second as a loop of one bar."""
    rows = ["path,seconds,kind,speaker_or_artist,title,language_or_genre,split"]
    for index in range(10):
        write_wav(path / f"{index}.wav", compose_track(index, 3.0, "speech", engine="own").audio)
        rows.append(f"{index}.wav,3,speech,{'Tom (m)' if index == 9 else f'Eve {index} (f)'},t,English,train")
    click = np.zeros(12_000, np.float32)
    click[:240] = np.random.default_rng(0).standard_normal(240) * np.hanning(240)
    write_wav(path / "bar.wav", 0.3 * np.tile(click, 4))
    (path / "manifest.csv").write_text("\n".join([*rows, "bar.wav,2,music,Band,Bar,waltz loop,train"]))
    return RecordedSound(path, "train")


def test_low_voices_are_heard_as_often_as_high_ones(tmp_path: Path) -> None:
    source, rng = folder(tmp_path), np.random.default_rng(0)
    said = [source.speech(rng, 2.0) for _ in range(40)]
    men = [track.sources[0].name == "Tom (m): t" for track in said]
    assert 0.3 < np.mean(men) < 0.7
    assert all(len(track.audio) % 800 == 0 for track in said)
    assert np.mean([bool(track.phrases) for track in said]) > 0.8  # some of the files are silent


def test_beats_follow_the_music_through_changes_of_tempo(tmp_path: Path) -> None:
    source, rng = folder(tmp_path), np.random.default_rng(1)
    tempos = set()
    for _ in range(8):
        piece = source.music(rng, 8.0)
        assert 7.9 < piece.seconds < 8.1
        assert (piece.style, piece.sources[0].name) == ("waltz", "Band: Bar")
        assert np.diff(piece.beats) == pytest.approx(60 / piece.bpm, abs=1e-6)
        power = np.abs(piece.audio)
        loud = [power[max(0, at - 720) : at + 720].max() for at in (24_000 * piece.beats[1:-1]).astype(int)]
        assert min(loud) > 0.5 * power.max()
        tempos.add(round(piece.bpm))
    assert len(tempos) > 3
