import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import DependencyError
from echoavatar_lab.evaluation.metrics import audio_events
from echoavatar_lab.evaluation.metrics.audio_events import EMAGE_RATE_HZ, music_beats, speech_onsets


def clicks(every_s: float, rate: int, seconds: float = 10.0) -> np.ndarray:
    """Short decaying tones."""
    audio = np.zeros(int(seconds * rate), np.float32)
    t = np.arange(int(0.08 * rate)) / rate
    tone = (np.sin(2 * np.pi * 880 * t) * np.exp(-t * 50)).astype(np.float32)
    for start in np.arange(0.5, seconds - 0.2, every_s):
        at = int(start * rate)
        audio[at : at + len(tone)] = tone
    return audio


def test_onsets_are_where_tones_begin() -> None:
    """To one hop of 32 ms."""
    pytest.importorskip("librosa", reason="the evaluate extra is not installed")
    found = speech_onsets(clicks(0.7, EMAGE_RATE_HZ), EMAGE_RATE_HZ)
    true = np.arange(0.5, 9.8, 0.7)
    assert np.abs(true[:, None] - found).min(1).max() < 0.05


def test_beats_are_as_far_apart_as_the_clicks() -> None:
    pytest.importorskip("librosa", reason="the evaluate extra is not installed")
    found = music_beats(clicks(0.5, 24_000), 24_000)
    assert np.median(np.diff(found)) == pytest.approx(0.5, abs=0.02)


def test_without_librosa_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "librosa", None)
    audio_events._librosa.cache_clear()
    with pytest.raises(DependencyError, match="evaluate"):
        speech_onsets(np.zeros(16_000, np.float32), EMAGE_RATE_HZ)


@pytest.mark.slow
def test_a_second_process_that_reads_the_cache_finds_the_same_beats(tmp_path: Path) -> None:
    """Three at once on an empty cache, and one more after them: numba's race used to crash the last."""
    pytest.importorskip("librosa", reason="the evaluate extra is not installed")
    script = (
        "import numpy as np; from echoavatar_lab.evaluation.metrics.audio_events import music_beats;"
        "x = np.zeros(192_000, np.float32); x[::12_000] = 1; print(len(music_beats(x, 24_000)))"
    )
    surroundings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def begin() -> "subprocess.Popen[str]":
        return subprocess.Popen([sys.executable, "-c", script], stdout=-1, text=True, env=surroundings)

    told = [process.communicate(timeout=300)[0] for process in [begin() for _ in range(3)]]
    last = begin()
    assert {*told, last.communicate(timeout=300)[0]} == {told[0]}
    assert int(told[0]) > 10
    assert last.returncode == 0
