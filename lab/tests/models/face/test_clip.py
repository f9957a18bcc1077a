import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar_lab.models.face.clip import FaceClip, load_clips


def make(frames: int = 5, **changes: object) -> FaceClip:
    rng = np.random.default_rng(0)
    audio = rng.uniform(-1, 1, frames * 800).astype(np.float32)
    values = {"name": "a", "audio": audio, "curves": rng.random((frames, 52)).astype(np.float32)}
    return FaceClip(**(values | changes))


def test_a_file_gives_back_the_clip(tmp_path):
    clip = make(split="test")
    clip.save(tmp_path / "a.npz")
    (loaded,) = load_clips(tmp_path)
    assert (loaded.name, loaded.split) == ("a", "test")
    np.testing.assert_allclose(loaded.audio, clip.audio, atol=2e-5)
    np.testing.assert_allclose(loaded.curves, clip.curves, atol=6e-4)


def test_columns_go_by_their_names(tmp_path):
    clip = make()
    order = [ARKIT_NAMES.index(name) for name in sorted(ARKIT_NAMES)]
    path = tmp_path / "b.npz"
    np.savez(
        path,
        name=np.array("b"),
        audio=np.zeros(4000, np.int16),
        curves=clip.curves[:, order],
        channels=np.array(sorted(ARKIT_NAMES)),
        split=np.array("train"),
    )
    assert np.array_equal(FaceClip.load(path).curves, clip.curves)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"curves": np.zeros((5, 51), np.float32)}, r"\(5, 51\), wanted \(frames, 52\)"),
        ({"audio": np.zeros(3999, np.float32)}, "wanted 4000"),
        ({"curves": np.full((5, 52), np.nan, np.float32)}, "not numbers"),
        ({"split": "dev"}, "'dev'"),
    ],
)
def test_what_does_not_fit_is_named(changes, words):
    with pytest.raises(MotionError, match=words):
        make(**changes)


def test_missing_and_damaged_files_are_named(tmp_path):
    with pytest.raises(MotionError, match="no face clips"):
        load_clips(tmp_path)
    (tmp_path / "c.npz").write_bytes(b"nothing")
    with pytest.raises(MotionError, match="c.npz is not a readable face clip"):
        load_clips(tmp_path)
