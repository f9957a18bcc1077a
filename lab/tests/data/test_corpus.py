import json

import numpy as np
import pytest
from lab.tests.data.test_clip import clip

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.data import ClipEntry, Corpus, Manifest, save_manifest, write_manifest
from echoavatar_lab.data.corpus import Shard, ShardEntry, checksum, clip_path, shard_path, write_shard


@pytest.fixture
def arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "rotations": rng.normal(size=(6, 3, 4)).astype(np.float32),
        "root": rng.normal(size=(6, 3)).astype(np.float32),
        "domain": np.array([0, 0, 1, 1, 2, 2], np.uint8),
        "audio": rng.integers(-9, 9, 6 * 800).astype(np.int16),
    }


def test_written_arrays_are_mapped_back(tmp_path, arrays):
    entry = write_shard(tmp_path, "00000", arrays, skeleton=2)
    shard = Shard(tmp_path, entry)
    assert (entry.frames, entry.skeleton) == (6, 2)
    for name, values in arrays.items():
        found = shard[name]
        assert isinstance(found, np.memmap)
        assert np.array_equal(found, values)
    assert not list(tmp_path.rglob("*.partial"))


def test_writing_to_a_mapped_array_does_not_reach_the_file(tmp_path, arrays):
    shard = Shard(tmp_path, write_shard(tmp_path, "00000", arrays))
    shard["root"][0] = 99.0
    assert np.array_equal(np.load(shard_path(tmp_path, "00000", "root")), arrays["root"])
    shard.verify()


def test_changed_missing_and_misshapen_files_are_named(tmp_path, arrays):
    entry = write_shard(tmp_path, "00000", arrays)
    with pytest.raises(MotionError, match="manifest says 7"):
        _ = Shard(tmp_path, entry.model_copy(update={"frames": 7}))["root"]
    root = shard_path(tmp_path, "00000", "root")
    np.save(root, arrays["root"] + 1)
    with pytest.raises(MotionError, match="root.npy changed"):
        Shard(tmp_path, entry).verify()
    root.write_bytes(root.read_bytes()[:90])
    with pytest.raises(MotionError, match="root.npy is damaged"):
        _ = Shard(tmp_path, entry)["root"]
    root.unlink()
    with pytest.raises(MotionError, match="root.npy is missing"):
        _ = Shard(tmp_path, entry)["root"]
    with pytest.raises(MotionError, match="root.npy is missing"):
        Shard(tmp_path, entry).verify()


def test_pickled_objects_are_not_read(tmp_path, arrays):
    entry = write_shard(tmp_path, "00000", arrays)
    np.save(shard_path(tmp_path, "00000", "root"), np.array([{}] * 6, dtype=object), allow_pickle=True)
    with pytest.raises(MotionError, match="damaged"):
        _ = Shard(tmp_path, entry)["root"]


def test_a_place_that_cannot_be_written_is_named(tmp_path, arrays):
    (tmp_path / "shards").write_text("a file where the folder should be")
    with pytest.raises(MotionError, match="cannot write"):
        write_shard(tmp_path, "00000", arrays)


def test_checksums_are_sha256(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    assert checksum(tmp_path / "a").startswith("ba7816bf8f01cfea")
    assert ShardEntry(name="0", frames=1, sha256={}).skeleton == 0


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


def test_invalid_corpora_are_explained(corpus, tmp_path):
    with pytest.raises(MotionError, match="not a corpus"):
        Corpus(tmp_path / "elsewhere")
    with pytest.raises(MotionError, match="no clip 'z'"):
        corpus.load("z")
    stored = json.loads((tmp_path / "manifest.json").read_text())
    for content in ("{", json.dumps({**stored, "surprise": 1})):
        (tmp_path / "manifest.json").write_text(content)
        with pytest.raises(MotionError, match="damaged"):
            Corpus(tmp_path)


@pytest.fixture
def sharded(tmp_path) -> Corpus:
    """Two clips end to end in one shard, the first also as a mirror image; a third without sound in another."""
    made = {name: clip(frames, name, "train", seed=frames) for name, frames in (("a", 4), ("b", 6), ("mute", 5))}
    shards = [
        write_shard(
            tmp_path,
            f"{number}",
            {
                key: np.concatenate([getattr(made[name], key) for name in names])
                for key in ("rotations", "root", "domain")
            }
            | ({"audio": np.concatenate([pcm(made[name]) for name in names])} if number == 0 else {}),
        )
        for number, names in enumerate((("a", "b"), ("mute",)))
    ]
    known = {"split": "train", "domains": {}}
    clips = [
        ClipEntry(name="a", frames=4, shard=0, events={"beats": (0.05,)}, **known),
        ClipEntry(name="a.mirror", frames=4, shard=0, mirrored=True, **known),
        ClipEntry(name="b", frames=6, shard=0, start=4, **known),
        ClipEntry(name="mute", frames=5, shard=1, has_sound=False, **known),
    ]
    return save_manifest(tmp_path, Manifest(format=2, clips=tuple(clips), shards=tuple(shards), info={"seed": 1}))


def pcm(one) -> np.ndarray:
    return np.round(np.clip(one.audio, -1, 1) * 32767).astype(np.int16)


def test_clips_in_shards_read_like_files(sharded):
    whole = sharded.load("b")
    made = clip(6, "b", "train", seed=6)
    assert np.array_equal(whole.rotations, made.rotations)
    assert np.array_equal(whole.root, made.root)
    np.testing.assert_allclose(whole.audio, made.audio, atol=1e-4)
    assert sharded.load("a").events["beats"].tolist() == [0.05]
    assert isinstance(sharded.motion("b").rotations, np.memmap)
    assert [one.name for one in sharded.clips("train")] == sharded.names("train")
    sharded.verify()


def test_mirror_images_are_computed_and_can_be_left_out(sharded):
    motion, image = sharded.motion("a"), sharded.motion("a.mirror")
    assert np.array_equal(image.root, motion.root * np.float32([-1, 1, 1]))
    left, right = (sharded.skeleton.index(f"{side}Hand") for side in ("left", "right"))
    assert np.array_equal(image.rotations[:, left], motion.rotations[:, right] * np.float32([1, 1, -1, -1]))
    assert np.array_equal(sharded.sound("a.mirror"), sharded.sound("a"))
    assert sharded.names(has_mirrored=False) == ["a", "b", "mute"]
    assert sharded.frames() == 15


def test_clips_without_sound_are_silent(sharded):
    assert not sharded.sound("mute").any()
    assert len(sharded.sound("mute")) == 4000
    assert not sharded.load("mute").audio.any()


def test_several_rigs_are_refused(sharded):
    assert sharded.skeleton is HUMANOID
    assert sharded.can_mirror
    other = HUMANOID.config.model_copy(update={"names": tuple(f"j{n}" for n in range(52))})
    manifest = sharded.manifest.model_copy(update={"skeletons": (HUMANOID.config, other)})
    two = save_manifest(sharded.folder, manifest)
    assert two.skeleton_of("b").names == HUMANOID.names
    with pytest.raises(MotionError, match="2 rigs"):
        _ = two.skeleton


def test_a_changed_shard_is_found(sharded):
    path = sharded.folder / "shards" / "0.root.npy"
    np.save(path, np.zeros((10, 3), np.float32))
    with pytest.raises(MotionError, match="0.root.npy changed"):
        sharded.verify()
