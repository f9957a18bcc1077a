from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import write_wav
from echoavatar_lab.tables import sound_labels
from echoavatar_lab.tables.sound_labels import f_measure, make


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
    found = {line.name: line.ours for line in make(experiment).lines}
    assert found["loops: beats, length known (1 clips)"]["f"].value == 1.0
    speech = found["synthetic speech: syllables (2 clips)"]
    assert speech["f"].value > 0.7 > speech["chance"].value
    monkeypatch.setattr(sources, "corpus", None)
    with pytest.raises(EchoAvatarError, match="manifest.csv"):
        sound_labels.make(experiment)
