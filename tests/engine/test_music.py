from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.engine.music import MusicPlayer, Tracks
from echoavatar.errors import EchoAvatarError

QUIET, LOUD = np.zeros(6_400, np.float32), np.full(6_400, 0.3, np.float32)
TRACK = np.linspace(0.1, 0.9, 20_000, dtype=np.float32)


def test_a_track_plays_once_through_and_then_there_is_none() -> None:
    player = MusicPlayer()
    assert player.next_chunk(QUIET) is None
    player.play("tune", TRACK)
    played = [player.next_chunk(QUIET) for _ in range(4)]
    np.testing.assert_allclose(np.concatenate(played)[:20_000], TRACK, rtol=1e-6)
    assert not np.concatenate(played)[20_000:].any()
    assert not player.is_playing
    assert player.next_chunk(QUIET) is None


def test_speech_brings_the_music_down_without_a_step_and_silence_lets_it_up() -> None:
    player = MusicPlayer()
    player.play("tone", np.ones(24_000 * 10, np.float32))
    level = np.concatenate([player.next_chunk(chunk) for chunk in [QUIET, LOUD, LOUD, *[QUIET] * 5]])
    assert level[6_399] == 1
    assert 0.3 < level[19_199] < 0.4
    assert np.argmax(level < 0.45) - 6_400 < 7_200  # heard under the speech within 0.3 s
    assert level[-1] == 1
    assert np.abs(np.diff(level)).max() < 2 / 6_000


@pytest.mark.parametrize(("peak", "ducks"), [(0.002, True), (0.0005, False)])
def test_only_speech_that_is_heard_brings_the_music_down(peak: float, ducks: bool) -> None:
    """-54 and -66 dBFS."""
    player = MusicPlayer()
    player.play("tone", np.ones(24_000 * 10, np.float32))
    assert (player.next_chunk(np.full(6_400, peak, np.float32))[-1] < 1) == ducks


def test_pauses_between_words_do_not_bring_the_music_back() -> None:
    """A pause of 0.27 s; after half a second it rises."""
    player = MusicPlayer()
    player.play("tone", np.ones(24_000 * 10, np.float32))
    level = [player.next_chunk(chunk)[-1] for chunk in [LOUD, LOUD, QUIET, LOUD, QUIET, QUIET]]
    assert max(level[1:5]) < 0.4
    assert level[5] > 0.6


def test_stopping_fades_out() -> None:
    player = MusicPlayer()
    player.play("tone", np.ones(24_000 * 10, np.float32))
    player.next_chunk(QUIET)
    player.stop()
    level = np.concatenate([player.next_chunk(QUIET) for _ in range(2)])
    assert (np.diff(level) <= 0).all()
    assert level[4_800] > 0.3  # no click
    assert level[9_600:].max() < 1e-3
    assert not player.is_playing


def test_going_back_plays_the_same_again_and_keeps_what_was_asked_since() -> None:
    player = MusicPlayer()
    player.play("tune", TRACK)
    player.next_chunk(QUIET)
    before = player.now
    second = player.next_chunk(LOUD)
    player.next_chunk(QUIET)
    player.rewind(1, before)
    np.testing.assert_array_equal(player.next_chunk(LOUD), second)
    player.stop()
    player.rewind(1, before)
    assert player.next_chunk(QUIET)[-1] < TRACK[12_799] / 2  # the stop still holds


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
