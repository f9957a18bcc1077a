"""A folder of BVH becomes a library: cut, cleaned, at the origin; written and read again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lab.tests.corpora.capture.people import library, stepping

from echoavatar.errors import MotionError
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar_lab.corpora.capture.catalogue import Entry
from echoavatar_lab.corpora.capture.library import clean, open_library, read_folder
from echoavatar_lab.corpora.controls import moved
from echoavatar_lab.corpora.solver import solve

STANDING = Entry("*", "standing", "waits")


def take(seconds: float = 8.0, **curves: object) -> Motion:
    """Somebody who stands two metres off, looks to the side, and looks at the floor."""
    controls = stepping(round(30 * seconds))
    controls = replace(controls, head=controls.head + np.array([0, 0.4, 0], np.float32), **curves)
    return Motion(HUMANOID, *solve(moved(controls, np.array([2.0, 1.0]), turn=1.0)), 30.0)


def folder_of(path: Path, *, manifest: str = "") -> Path:
    (path / "standing").mkdir()
    motion = take()
    write_bvh(path / "standing" / "a.bvh", HUMANOID, motion.rotations, motion.root, 30.0)
    write_bvh(path / "other.bvh", HUMANOID, motion.rotations, motion.root, 30.0)
    if manifest:
        (path / "manifest.csv").write_text(f"file,licence,use\nx/standing/a.bvh,MIT,{manifest}\n")
    return path


def test_a_take_starts_at_the_origin_faces_ahead_and_looks_up():
    (controls,) = clean(take(), STANDING)
    assert np.abs(controls.pelvis_position[:15, [0, 2]].mean(0)).max() < 1e-5
    assert abs(controls.pelvis_rotation[:15, 0].mean()) < 1e-4
    gaze = controls.pelvis_rotation[:, 1] + controls.spine[:, 1] + controls.head[:, 1]
    assert np.median(gaze) < 0.12
    assert np.ptp(controls.fingers, axis=0).max() > 0.01


def test_bad_spans_and_the_end_are_cut_and_short_stretches_dropped():
    pieces = list(clean(take(), replace(STANDING, last_s=1.0), [(2.5, 2.6), (4.0, 4.1)]))
    assert [round(len(piece) / 30, 1) for piece in pieces] == pytest.approx([2.4, 2.8], abs=0.15)


def test_shaking_is_smoothed_and_swings_are_kept():
    motion = take()
    shaken = motion.rotations + 0.01 * np.random.default_rng(0).standard_normal(motion.rotations.shape)
    shaken /= np.linalg.norm(shaken, axis=-1, keepdims=True)
    still, noisy = take(), replace(motion, rotations=shaken.astype(np.float32))
    entry = replace(STANDING, cutoff_hz=5.0)
    calm, rough = (next(clean(m, entry)).wrist for m in (still, noisy))
    unsmoothed = next(clean(noisy, replace(STANDING, cutoff_hz=15.0))).wrist
    assert np.abs(np.diff(rough, 2, axis=0)).mean() < 0.35 * np.abs(np.diff(unsmoothed, 2, axis=0)).mean()
    assert np.ptp(calm[..., 2], axis=0) == pytest.approx(
        np.ptp(next(clean(motion, STANDING)).wrist[..., 2], axis=0), rel=0.05
    )


def test_a_frozen_head_follows_the_chest():
    rotations = take().rotations.copy()
    rotations[:, HUMANOID.index("head")] = [0.6, 0.0, 0.8, 0.0]
    (controls,) = clean(replace(take(), rotations=rotations), replace(STANDING, is_head_frozen=True))
    assert np.abs(controls.head[:, 0]).max() < 0.01


def test_a_dance_loses_its_still_opening():
    motion = take(6.0)
    frozen = np.concatenate([np.repeat(motion.rotations[:1], 60, 0), motion.rotations])
    root = np.concatenate([np.repeat(motion.root[:1], 60, 0), motion.root])
    (controls,) = clean(Motion(HUMANOID, frozen, root, 30.0), Entry("*", "dance", "modern", cutoff_hz=15))
    assert 170 <= len(controls) <= 195


def test_a_folder_is_read_with_its_licences_and_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "data").mkdir()
    folder = folder_of(tmp_path / "data", manifest="may train shipped weights")
    found = open_library(folder)
    assert [(clip.name, clip.kind, clip.licence) for clip in found.clips] == [("a", "standing", "MIT")]
    assert found.credits() == {"standing": "MIT"}
    (kept,) = (tmp_path / "cache" / "echoavatar").glob("captured-*.npz")
    before = kept.stat().st_mtime_ns
    np.testing.assert_array_equal(open_library(folder).clips[0].controls.packed(), found.clips[0].controls.packed())
    assert kept.stat().st_mtime_ns == before


def test_files_that_may_not_train_are_left_out(tmp_path):
    with pytest.raises(MotionError, match="no captured set"):
        read_folder(folder_of(tmp_path, manifest="tests and evaluation only"))


def test_a_saved_library_comes_back(tmp_path):
    people = library()
    people.save(tmp_path / "people.npz")
    again = open_library(tmp_path / "people.npz")
    assert [(c.name, c.kind, c.group, c.licence) for c in again.clips] == [
        (c.name, c.kind, c.group, c.licence) for c in people.clips
    ]
    for one, other in zip(people.clips, again.clips, strict=True):
        np.testing.assert_array_equal(one.controls.packed(), other.controls.packed())


def test_a_missing_or_damaged_library_is_explained(tmp_path):
    with pytest.raises(MotionError, match="data capture"):
        open_library(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"no")
    with pytest.raises(MotionError, match="damaged"):
        open_library(tmp_path / "bad.npz")
