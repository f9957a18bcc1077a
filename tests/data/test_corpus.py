import json

import numpy as np
import pytest
from tests.data.test_clip import clip

from echoavatar.data import Corpus, write_manifest
from echoavatar.data.corpus import clip_path
from echoavatar.errors import MotionError


@pytest.fixture
def corpus(tmp_path) -> Corpus:
    for name, split, frames in (("b", "train", 6), ("a", "train", 4), ("c", "test", 5)):
        clip(frames, name, split, seed=frames).save(clip_path(tmp_path, name))
    return write_manifest(tmp_path, {"seed": 7})


def test_clips_are_listed_by_split_and_name(corpus):
    assert corpus.names() == ["a", "b", "c"]
    assert corpus.names("train") == ["a", "b"]
    assert corpus.frames("test") == 5
    assert [each.name for each in corpus.clips("train")] == ["a", "b"]
    assert corpus.manifest.info == {"seed": 7}


def test_frames_of_each_domain_are_counted(corpus):
    entry = corpus.entries("test")[0]
    assert sum(entry.domains.values()) == 5
    assert entry.domains["music"] == int((corpus.load("c").domain == 2).sum())


def test_motion_is_read_without_sound(corpus):
    motion, whole = corpus.motion("b"), corpus.load("b")
    assert np.array_equal(motion.rotations, whole.rotations)
    assert np.array_equal(motion.root, whole.root)


def test_changed_and_missing_clips_are_found(corpus):
    corpus.verify()
    clip(6, "b", seed=1).save(corpus.path("b"))
    with pytest.raises(MotionError, match="b.npz changed"):
        corpus.verify()
    corpus.path("b").unlink()
    with pytest.raises(MotionError, match="b.npz is missing"):
        corpus.verify()


def test_what_is_no_corpus_is_explained(corpus, tmp_path):
    with pytest.raises(MotionError, match="no corpus"):
        Corpus(tmp_path / "elsewhere")
    with pytest.raises(MotionError, match="no clip 'z'"):
        corpus.load("z")
    stored = json.loads((tmp_path / "manifest.json").read_text())
    for content in ("{", json.dumps({**stored, "surprise": 1})):
        (tmp_path / "manifest.json").write_text(content)
        with pytest.raises(MotionError, match="damaged"):
            Corpus(tmp_path)


def test_only_named_clips_are_listed_on_request(corpus):
    assert write_manifest(corpus.folder, names=["c", "a"]).names() == ["a", "c"]
