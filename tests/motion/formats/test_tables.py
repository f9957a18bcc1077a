import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.formats import tables
from echoavatar.motion.formats.tables import read_npz, write_csv, write_live_link, write_npz
from echoavatar.motion.kinematics import Motion, Skeleton, SkeletonConfig
from echoavatar_lab.models.face.clip import read_live_link


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
    write_npz(tmp_path / "a.npz", swaying(2))
    np.savez(tmp_path / "a.npz", **(tables.arrays_of(tmp_path / "a.npz") | change))
    with pytest.raises(MotionError):
        read_npz(tmp_path / "a.npz")


def test_a_pipe_is_refused_before_it_is_opened(tmp_path):
    os.mkfifo(tmp_path / "a.npz")
    with pytest.raises(MotionError, match="not a regular file"):
        read_npz(tmp_path / "a.npz")


def curves(frames: int) -> np.ndarray:
    return np.random.default_rng(0).random((frames, 52)).astype(np.float32)


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_a_live_link_take_reads_back(tmp_path: Path, fps: float) -> None:
    """At 60 fps the reader keeps every second frame; frames past a full second carry over into the seconds."""
    written = curves(70)
    write_live_link(tmp_path / "take.csv", written, fps)
    read = read_live_link(tmp_path / "take.csv")
    np.testing.assert_allclose(read, written[:: round(fps / 30)], atol=2e-3)


def test_an_unwritable_live_link_take_is_named(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="choose another place"):
        write_live_link(tmp_path / "no" / "take.csv", curves(3))


def test_no_name_of_a_joint_is_a_formula_or_ends_a_cell_or_a_line(tmp_path: Path) -> None:
    motion = swaying()
    names = ("=cmd|'/c calc'!A1", "@a", 'b,";c', *motion.skeleton.names[3:])
    hostile = Skeleton(motion.skeleton.config.model_copy(update={"names": names}))
    write_csv(tmp_path / "a.csv", Motion(hostile, motion.rotations, motion.root, motion.fps))
    head = (tmp_path / "a.csv").read_text("utf-8").splitlines()[0].split(",")
    assert head[4] == "_cmd|'/c calc'!A1.w"
    assert (head[8], head[12]) == ("_a.w", "b___c.w")
    for name in ("a\nb", "", "\x1b[31m", "x" * 300):
        with pytest.raises(ValidationError, match="no name of a joint"):
            SkeletonConfig.model_validate(motion.skeleton.config.model_dump() | {"names": (name, *names[1:])})


def test_more_texts_than_are_read_are_refused_before_each_becomes_an_object(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", names=np.zeros(1 << 17, "S1"))
    with pytest.raises(ValueError, match="131,072 texts"):
        tables.arrays_of(tmp_path / "a.npz")
