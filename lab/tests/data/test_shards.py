import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar_lab.data.shards import Shard, ShardEntry, checksum, shard_path, write_shard


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
    assert (entry.frames, entry.skeleton, shard.has_sound) == (6, 2, True)
    for name, values in arrays.items():
        found = getattr(shard, name)
        assert isinstance(found, np.memmap)
        assert np.array_equal(found, values)
    assert not list(tmp_path.rglob("*.part"))


def test_writing_to_a_mapped_array_does_not_reach_the_file(tmp_path, arrays):
    shard = Shard(tmp_path, write_shard(tmp_path, "00000", arrays))
    shard.root[0] = 99.0
    assert np.array_equal(np.load(shard.path("root")), arrays["root"])
    shard.verify()


def test_changed_missing_and_misshapen_files_are_named(tmp_path, arrays):
    entry = write_shard(tmp_path, "00000", arrays)
    with pytest.raises(MotionError, match="manifest says 7"):
        _ = Shard(tmp_path, entry.model_copy(update={"frames": 7})).root
    root = shard_path(tmp_path, "00000", "root")
    np.save(root, arrays["root"] + 1)
    with pytest.raises(MotionError, match="root.npy changed"):
        Shard(tmp_path, entry).verify()
    root.write_bytes(root.read_bytes()[:90])
    with pytest.raises(MotionError, match="root.npy is damaged"):
        _ = Shard(tmp_path, entry).root
    root.unlink()
    with pytest.raises(MotionError, match="root.npy is missing"):
        _ = Shard(tmp_path, entry).root
    with pytest.raises(MotionError, match="root.npy is missing"):
        Shard(tmp_path, entry).verify()


def test_pickled_objects_are_not_read(tmp_path, arrays):
    entry = write_shard(tmp_path, "00000", arrays)
    np.save(shard_path(tmp_path, "00000", "root"), np.array([{}] * 6, dtype=object), allow_pickle=True)
    with pytest.raises(MotionError, match="damaged"):
        _ = Shard(tmp_path, entry).root


def test_a_place_that_cannot_be_written_is_named(tmp_path, arrays):
    (tmp_path / "shards").write_text("a file where the folder should be")
    with pytest.raises(MotionError, match="cannot be written"):
        write_shard(tmp_path, "00000", arrays)


def test_checksums_are_sha256(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    assert checksum(tmp_path / "a").startswith("ba7816bf8f01cfea")
    assert ShardEntry(name="0", frames=1, sha256={}).skeleton == 0
