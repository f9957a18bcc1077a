import numpy as np
import pytest

from echoavatar_lab.corpora.music.beat_tracker import onset_strength, track_beats
from echoavatar_lab.corpora.music.instruments import render
from echoavatar_lab.corpora.music.music import compose_piece


def recall(true: np.ndarray, found: np.ndarray) -> float:
    return float(np.mean([np.min(np.abs(found - t)) < 0.05 for t in true]))


def clicks(period: float, count: int) -> np.ndarray:
    audio = np.zeros(round((count + 1) * period * 24000), np.float32)
    for i in range(count):
        at = round((0.3 + i * period) * 24000)
        audio[at : at + 240] = np.hanning(240) * np.random.default_rng(i).standard_normal(240)
    return audio


@pytest.mark.parametrize("period", [0.4, 0.5, 0.75])
def test_clicks_give_their_tempo(period):
    found = track_beats(clicks(period, 24))
    assert found.bpm == pytest.approx(60 / period, rel=0.03)
    true = 0.3 + period * np.arange(24)
    assert recall(true[1:-1], found.beats) > 0.95


@pytest.mark.parametrize("style", ["house", "waltz", "rock", "ballad", "march"])
def test_own_music_is_tracked(style):
    piece = compose_piece(np.random.default_rng(41), 20.0, style)
    found = track_beats(render(piece, np.random.default_rng(1)))
    assert recall(piece.beats, found.beats) > 0.9


def test_silence_and_noise_have_no_beats():
    noise = 0.1 * np.random.default_rng(0).standard_normal(20 * 24000).astype(np.float32)
    for audio in (np.zeros(48000, np.float32), noise):
        found = track_beats(audio)
        assert len(found.beats) == len(found.downbeats) == 0


def test_a_loop_is_counted_by_its_length_though_the_loudest_strokes_lie_between_the_beats():
    bar = np.zeros(48_000, np.float32)
    for eighth, level in enumerate([0.1, 1, 0.1, 1, 0.1, 1, 0.1, 1]):
        bar[6000 * eighth :][:2400] = level * np.random.default_rng(eighth).standard_normal(2400) * np.hanning(2400)
    found = track_beats(np.tile(bar, 6), loop_s=2.0)
    assert found.bpm == pytest.approx(120)
    assert np.allclose(found.beats, 0.5 * np.arange(24))
    assert np.allclose(found.downbeats, 2.0 * np.arange(6))


def test_onset_strength_peaks_at_the_click():
    onsets = onset_strength(clicks(0.5, 1))
    assert abs(int(np.argmax(onsets.full)) - 30) <= 2
