from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.errors import EchoAvatarError
from echoavatar.server.tracks import Tracks


def test_a_folder_adds_tracks(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "Evening walk.wav", np.full(8_000, 0.1, np.float32), 8_000)
    (tmp_path / "notes.txt").write_text("not music")
    tracks = Tracks(tmp_path)
    assert "Evening walk" in tracks.titles
    assert "notes" not in tracks.titles
    assert len(tracks.load("Evening walk")) == 24_000


def test_music_ships() -> None:
    tracks = Tracks()
    assert len(tracks.load(tracks.titles[0])) > 5 * 24_000


def test_an_unknown_title_is_answered_with_those_there_are() -> None:
    with pytest.raises(EchoAvatarError, match=Tracks().titles[0]):
        Tracks().load("Silence")


def test_a_folder_that_is_not_there_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="--music"):
        Tracks(tmp_path / "none")
