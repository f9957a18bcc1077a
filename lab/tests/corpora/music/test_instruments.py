import numpy as np
import pytest

from echoavatar_lab.corpora.music.instruments import TIMBRES, render
from echoavatar_lab.corpora.music.music import compose_piece
from echoavatar_lab.corpora.music.soundfont import _DRUMS
from echoavatar_lab.corpora.sound import Note, Piece


def single(instrument: str, pitch: int, start: float = 0.5) -> Piece:
    note = Note(start, 0.6, pitch, 0.8, instrument)
    return Piece((note,), np.array([start]), np.array([start]), (), "", 60.0, 1.5, is_cut=True)


@pytest.mark.parametrize("instrument", [*TIMBRES, *_DRUMS])
def test_a_note_starts_on_its_sample_and_is_heard(instrument):
    pitch = 60 if instrument in TIMBRES else 0
    audio = render(single(instrument, pitch), np.random.default_rng(0))
    assert len(audio) == 36000
    assert np.abs(audio[:12000]).max() == 0
    assert np.abs(audio[12000:15000]).max() > 0.05
    assert np.isfinite(audio).all()


@pytest.mark.parametrize("instrument", ["piano", "strings", "voice_aah", "finger_bass", "clarinet"])
def test_a_note_has_its_pitch(instrument):
    audio = render(single(instrument, 57, 0.0), np.random.default_rng(1))[2400:14400]
    correlation = np.correlate(audio, audio[:8000], mode="valid")
    lag = 60 + int(np.argmax(correlation[60:200]))
    assert 24000 / lag == pytest.approx(220, rel=0.02)


def test_a_cut_piece_is_loud_to_the_end_and_a_finished_one_fades():
    for seed in range(6):
        piece = compose_piece(np.random.default_rng(seed), 10.0, "house")
        audio = render(piece, np.random.default_rng(seed))
        tail = np.sqrt(np.mean(audio[-1200:] ** 2)) / np.sqrt(np.mean(audio**2))
        assert (tail > 0.1) if piece.is_cut else (tail < 0.1)
