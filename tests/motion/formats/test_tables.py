import csv
import json
import os

import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.formats import tables
from echoavatar.motion.formats.tables import read_npz, write_csv, write_npz


def test_npz_comes_back(tmp_path):
    motion = swaying(7)
    write_npz(tmp_path / "a.npz", motion)
    back = read_npz(tmp_path / "a.npz")
    assert back.skeleton == motion.skeleton
    assert back.fps == motion.fps
    assert np.array_equal(back.rotations, motion.rotations)
    assert np.array_equal(back.root, motion.root)


def test_csv_names_its_columns(tmp_path):
    motion = swaying(4)
    write_csv(tmp_path / "a.csv", motion)
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    assert float(rows[3]["time"]) == pytest.approx(0.1, abs=1e-6)
    assert float(rows[2]["root.y"]) == pytest.approx(motion.root[2, 1], abs=1e-6)
    hand = motion.skeleton.index("leftHand")
    found = [float(rows[2][f"leftHand.{axis}"]) for axis in "wxyz"]
    np.testing.assert_allclose(found, motion.rotations[2, hand], atol=1e-6)


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04broken"])
def test_foreign_files_are_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(MotionError, match="write it again"):
        read_npz(tmp_path / "a.npz")


def test_missing_and_unwritable_files_are_explained(tmp_path):
    with pytest.raises(MotionError, match="does not exist"):
        read_npz(tmp_path / "none.npz")
    for write in (write_csv, write_npz):
        with pytest.raises(MotionError, match="cannot write"):
            write(tmp_path / "missing" / "a", swaying(1))
    assert list(tmp_path.iterdir()) == []


def test_arrays_that_unpack_to_too_much_are_refused_before_they_do(tmp_path, monkeypatch):
    """Three megabytes of NPZ asked for three gigabytes."""
    monkeypatch.setattr(tables, "ARRAYS_BYTES", 1 << 16)
    write_npz(tmp_path / "a.npz", swaying(2), beside=np.zeros(1 << 15))
    with pytest.raises(MotionError, match=r"a\.npz unpacks to .* bytes, and at most 65,536"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"fps": np.array(float("nan"))},
        {"root": np.zeros(6)},
        {"rotations": np.array(["x"])},
        {"skeleton": np.array("[" * 100_000)},
        {"skeleton": np.array(json.dumps({"names": ["a"] * 5000, "parents": [], "offsets": []}))},
    ],
    ids=["rate", "root", "texts", "nested", "joints"],
)
def test_arrays_that_are_no_motion_are_refused(tmp_path, change):
    motion = swaying(2)
    np.savez(tmp_path / "a.npz", **(tables._arrays(motion) | change))
    with pytest.raises(MotionError):
        read_npz(tmp_path / "a.npz")


def test_a_pipe_is_refused_before_it_is_opened(tmp_path):
    os.mkfifo(tmp_path / "a.npz")
    with pytest.raises(MotionError, match="not a regular file"):
        read_npz(tmp_path / "a.npz")
