import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_lab.corpora.rehearsal.faces import TEST_EVERY, rehearse_clip, rehearse_faces
from echoavatar_lab.models.face.clip import load_clips


def test_lips_move_with_the_voice_and_a_clip_is_the_same_whoever_makes_it():
    clip = rehearse_clip(3, 0, seconds=6.0)
    again = rehearse_clip(3, 0, seconds=6.0)
    assert np.array_equal(clip.audio, again.audio)
    assert np.array_equal(clip.curves, again.curves)
    loud = np.square(clip.audio.reshape(-1, 800)).mean(1)
    jaw = clip.curves[:, ARKIT_NAMES.index("jawOpen")]
    assert jaw.max() > 0.2
    assert jaw[loud > np.quantile(loud, 0.8)].mean() > 2 * jaw[loud < 1e-7].mean()


def test_a_folder_is_completed_and_holds_both_splits(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(
        "echoavatar_lab.corpora.rehearsal.faces.rehearse_clip",
        lambda seed, index: made.append(index) or rehearse_clip(seed, index, seconds=1.0),
    )
    rehearse_faces(tmp_path, hours=0.01, seed=1)
    assert made == list(range(TEST_EVERY))
    (tmp_path / "face-1-0002.npz").unlink()
    rehearse_faces(tmp_path, hours=0.01, seed=1)
    assert made[TEST_EVERY:] == [2]
    assert {clip.split for clip in load_clips(tmp_path)} == {"train", "test"}
    with pytest.raises(EchoAvatarError, match="--hours"):
        rehearse_faces(tmp_path, hours=0, seed=1)
