import numpy as np
import pytest

from echoavatar.errors import AudioError
from echoavatar.models.audio import write_wav
from echoavatar.models.audio.pool import AudioGroup, AudioPool, read_group, to_int16


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


def test_folders_of_sound_and_of_clips(tmp_path):
    sound = np.linspace(-0.5, 0.5, 2_400).astype(np.float32)
    write_wav(tmp_path / "a.wav", sound)
    (tmp_path / "clips").mkdir()
    np.savez(tmp_path / "clips" / "b.npz", audio=sound)
    (tmp_path / "notes.txt").write_text("not sound")
    found = read_group(tmp_path, weight=2)
    assert (found.name, found.weight, len(found.recordings)) == (tmp_path.name, 2, 2)
    for recording in found.recordings:
        np.testing.assert_allclose(recording / 32_768, sound, atol=1e-4)


def test_clips_of_a_corpus_keep_their_loudness(tmp_path):
    """Clips store 16-bit sound; read as if it were -1..1 it would clip to a square wave."""
    sound = np.array([-16_000, -1, 0, 1, 8_000], np.int16)
    np.savez(tmp_path / "clip.npz", audio=sound)
    assert np.array_equal(read_group(tmp_path).recordings[0], sound)


def test_no_sound_at_all_is_refused(tmp_path):
    with pytest.raises(AudioError, match="every folder given is empty"):
        AudioPool([read_group(tmp_path)])
