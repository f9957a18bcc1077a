import numpy as np
import pytest

from echoavatar_lab.corpora.music.music import compose_piece
from echoavatar_lab.corpora.music.styles import STYLES


@pytest.mark.parametrize("style", list(STYLES))
def test_beats_have_the_tempo_and_downbeats_the_metre(style):
    for seed in range(3):
        piece = compose_piece(np.random.default_rng(seed), 24.0, style)
        assert 60 / np.median(np.diff(piece.beats)) == pytest.approx(piece.bpm, rel=0.07)
        metre = STYLES[style].beats_per_bar
        assert np.array_equal(piece.downbeats, piece.beats[::metre])
        bar_s = 60 / piece.bpm * metre
        if piece.is_cut:
            assert 0.9 * 24 - bar_s < piece.seconds <= 24
        else:
            assert piece.seconds - 2.5 == pytest.approx(24, rel=0.06, abs=bar_s)
        assert piece.beats[-1] <= piece.seconds


@pytest.mark.parametrize("style", list(STYLES))
def test_nearly_every_beat_is_played(style):
    piece = compose_piece(np.random.default_rng(7), 24.0, style)
    starts = np.array([note.start for note in piece.notes])
    near = [np.min(np.abs(starts - beat)) < 0.02 for beat in piece.beats[:-1]]
    assert np.mean(near) > 0.7


def test_sections_follow_each_other_and_differ_in_energy():
    piece = compose_piece(np.random.default_rng(2), 60.0, "house")
    assert all(a.end == pytest.approx(b.start) for a, b in zip(piece.sections, piece.sections[1:], strict=False))
    energies = [section.energy for section in piece.sections]
    assert max(energies) - min(energies) > 0.3
    assert min(energies) > 0
    assert max(energies) <= 1


def test_louder_sections_have_more_and_louder_notes():
    piece = compose_piece(np.random.default_rng(2), 60.0, "rock")

    def loudness(section):
        inside = [n.velocity for n in piece.notes if section.start <= n.start < section.end]
        return sum(inside) / (section.end - section.start)

    ranked = sorted(piece.sections, key=lambda s: s.energy)
    assert loudness(ranked[-1]) > 1.5 * loudness(ranked[0])


def test_some_pieces_have_no_drums_and_some_stop_abruptly():
    pieces = [compose_piece(np.random.default_rng(seed), 15.0) for seed in range(30)]
    drummed = [any(note.pitch == 0 for note in piece.notes) for piece in pieces]
    assert 0.3 < np.mean(drummed) < 0.9
    assert 0.2 < np.mean([piece.is_cut for piece in pieces]) < 0.8
