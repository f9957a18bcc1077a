import numpy as np
import pytest

from echoavatar.errors import AudioError
from echoavatar.models.audio import write_wav
from echoavatar_lab.models.audio.pool import AudioGroup, AudioPool, read_groups
from echoavatar_lab.models.audio.recorded_files import to_int16

pytestmark = pytest.mark.usefixtures("own_cache")


def group(name: str, value: float, weight: float, samples: int = 24_000) -> AudioGroup:
    return AudioGroup(name, (to_int16(np.full(samples, value, np.float32)),), weight)


def test_groups_are_drawn_by_weight():
    pool = AudioPool([group("a", 0.25, 3), group("b", -0.5, 1)])
    rng = np.random.default_rng(0)
    drawn = np.array([pool.draw(rng, 100)[0] for _ in range(400)])
    assert set(np.unique(drawn)) == {0.25, -0.5}
    assert 0.68 < np.mean(drawn == 0.25) < 0.82
    assert pool.seconds == {"a": 1.0, "b": 1.0}


def test_short_recordings_are_followed_by_silence():
    piece = AudioPool([group("a", 0.5, 1, samples=10)]).draw(np.random.default_rng(0), 30)
    assert piece.tolist() == [0.5] * 10 + [0.0] * 20


def test_a_folder_gives_a_group_of_speech_and_one_of_music(tmp_path):
    sound = np.linspace(-0.5, 0.5, 2_400).astype(np.float32)
    write_wav(tmp_path / "a.wav", sound)
    write_wav(tmp_path / "music.wav", 0.5 * sound)
    speech, music = read_groups(tmp_path)
    assert (speech.name, music.name) == (f"{tmp_path.name}: speech", f"{tmp_path.name}: music")
    for group_, wanted in ((speech, sound), (music, 0.5 * sound)):
        np.testing.assert_allclose(group_.recordings[0] / 32_768, wanted, atol=1e-4)


def test_no_sound_at_all_is_refused(tmp_path):
    with pytest.raises(AudioError, match="every folder given is empty"):
        AudioPool([AudioGroup("nothing", ())])
    with pytest.raises(AudioError, match="no sound"):
        read_groups(tmp_path)
