from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.engine.tracks import Tracks
from echoavatar.errors import EchoAvatarError


def test_what_ships_is_there_small_and_loud_enough() -> None:
    tracks = Tracks()
    assert len(tracks.titles) >= 3
    shipped = Path(__file__).parents[2] / "src" / "echoavatar" / "assets" / "music"
    assert sum(path.stat().st_size for path in shipped.iterdir()) < 1.5e6
    sound = tracks.load(tracks.titles[0])
    assert len(sound) > 30 * 24_000
    assert 0.05 < np.sqrt(np.mean(sound**2)) < 0.3


def test_a_folder_adds_to_it_and_unknown_titles_answer_with_the_list(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "Own_Song.wav", np.zeros(2_400), 24_000)
    (tmp_path / "notes.txt").write_text("not music")
    tracks = Tracks(tmp_path)
    assert tracks.titles[-1] == "Own Song"
    assert len(tracks.load("own song")) == 2_400
    with pytest.raises(EchoAvatarError, match="there is: .*Own Song"):
        tracks.load("notes")
    with pytest.raises(EchoAvatarError, match="no folder"):
        Tracks(tmp_path / "none")
