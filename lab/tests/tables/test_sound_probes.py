from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import write_wav
from echoavatar_lab.corpora.rehearsal.track import compose_track
from echoavatar_lab.tables import sound_probes
from echoavatar_lab.tables.sound_probes import (
    KnownSound,
    _f_measure,
    f_measure,
    known,
    make_labels,
    score,
    train_reader,
)


def test_each_event_counts_once() -> None:
    assert f_measure([1.0, 2.0, 3.0], [1.05, 1.06, 2.1, 2.95]) == pytest.approx(2 * 2 / 7)
    assert f_measure([], [1.0]) == 0


def test_the_table_has_speech_music_and_the_loops_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_cache: Path
) -> None:
    click = np.zeros(12_000, np.float32)
    click[:2400] = np.random.default_rng(0).standard_normal(2400) * np.hanning(2400)
    write_wav(tmp_path / "loop_amen.wav", 0.3 * np.tile(click, 4))
    (tmp_path / "manifest.csv").write_text("path,kind,split\nloop_amen.wav,music,train\n")
    scale, sources = SimpleNamespace(name="tiny"), SimpleNamespace(corpus=tmp_path)
    experiment = SimpleNamespace(scale=scale, sources=sources, seed=0, say=lambda line: None)
    found = {line.name: line.ours for line in make_labels(experiment).lines}
    assert found["loops: beats, length known (1 clips)"]["f"].value == 1.0
    speech = found["synthetic speech: syllables (2 clips)"]
    assert speech["f"].value > 0.7 > speech["chance"].value
    monkeypatch.setattr(sources, "corpus", None)
    with pytest.raises(EchoAvatarError, match="manifest.csv"):
        sound_probes.make_labels(experiment)


def test_events_count_once_within_70_ms() -> None:
    marks, strength = np.zeros(300), np.zeros(300)
    marks[[50, 100, 200]] = 1
    strength[[53, 108, 201]] = 1.0  # 40, 107 and 13 ms off
    assert _f_measure([(strength, marks)], 0.5) == pytest.approx(2 * 2 / 6)
    assert _f_measure([(strength, np.zeros(300)), (marks, marks)], 0.5) == 1.0


def test_what_is_known_of_a_track_lies_on_the_frames_of_the_codes() -> None:
    track = compose_track(4, 8.0, "speech", engine="own")
    sound = known(track)
    assert {len(part) for part in sound[1:]} == {600}
    assert set(np.unique(sound.domain)) <= {0, 1}
    assert sound.voiced[sound.domain == 1].mean() > 0.4
    assert sound.events[:, 2].sum() == 0
    assert sound.events[:, 1].sum() == pytest.approx(sum(s.prominence >= 0.45 for s in track.syllables), abs=1)


@pytest.mark.slow
def test_a_reader_finds_what_the_codes_say_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)

    def sound(is_heard: bool) -> KnownSound:
        domain = np.repeat(rng.integers(0, 3, 20), 40)
        heard = domain if is_heard else rng.permutation(domain)
        return KnownSound(heard.astype(np.float32), domain, (domain == 1) * 1.0, 5.0 * domain, np.zeros((800, 3)))

    def codes(codec: object, audio: np.ndarray) -> np.ndarray:
        return np.stack([audio, 0 * audio], axis=1).astype(np.int16)

    monkeypatch.setattr(sound_probes, "audio_codes", codes)
    codec = SimpleNamespace(config=SimpleNamespace(codes=4), codebooks=torch.zeros(2, 4, 8))
    assert sound_probes.heard(None, np.zeros(3200, np.float32)).shape == (10, 64)
    for is_heard, low, high in ((True, 0.95, 1.0), (False, 0.0, 0.6)):
        reader, ends = train_reader(codec, [sound(is_heard) for _ in range(6)], steps=60, seed=0)
        assert low <= score(codec, reader, ends, [sound(is_heard) for _ in range(4)])["domain"] <= high
