import shutil
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import DependencyError
from echoavatar_lab.corpora.music.soundfont import render_soundfont
from echoavatar_lab.corpora.sound import Note, Piece

FLUID_R3 = Path("/usr/share/sounds/sf2/FluidR3_GM.sf2")


def test_notes_begin_where_the_score_says():
    if shutil.which("fluidsynth") is None or not FLUID_R3.is_file():
        pytest.skip("fluidsynth or FluidR3_GM.sf2 is not installed")
    pytest.importorskip("pretty_midi")
    notes = tuple(Note(t, 0.2, 0, 0.9, "clave") for t in (0.5, 1.0, 1.5))
    piece = Piece(notes, np.array([0.5, 1.0, 1.5]), np.array([0.5]), (), "", 120.0, 2.0, is_cut=True)
    audio = render_soundfont(piece, np.random.default_rng(0), FLUID_R3)
    assert len(audio) == 48000
    for start in (0.5, 1.0, 1.5):
        at = round(start * 24000)
        before, after = np.abs(audio[at - 1200 : at - 120]).max(), np.abs(audio[at : at + 240]).max()
        assert after > 5 * before + 0.01


def test_a_missing_sound_font_is_named():
    if shutil.which("fluidsynth") is None:
        pytest.skip("fluidsynth is not installed")
    piece = Piece((), np.zeros(0), np.zeros(0), (), "", 60.0, 1.0, is_cut=True)
    with pytest.raises(DependencyError, match=r"nowhere\.sf2"):
        render_soundfont(piece, np.random.default_rng(0), Path("nowhere.sf2"))


def test_a_missing_player_is_named(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    piece = Piece((), np.zeros(0), np.zeros(0), (), "", 60.0, 1.0, is_cut=True)
    with pytest.raises(DependencyError, match="apt install fluidsynth"):
        render_soundfont(piece, np.random.default_rng(0), FLUID_R3)
