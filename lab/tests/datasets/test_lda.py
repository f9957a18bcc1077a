"""Dances as LDA publishes them are the motion they were made of."""

from pathlib import Path

import numpy as np
import pytest
from lab.tests.datasets.samples import gesture, lda_columns, motorica_names, pickled_frame, renamed, write_lda

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.kinematics.retarget import retarget
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from echoavatar_lab.datasets.lda import PARENTS, read_lda


def walking() -> Motion:
    """A gesture that walks along a circle, on Motorica's names."""
    motion = gesture(3.0, 30.0, fingers=0.0)
    time = np.arange(motion.frames) / 30
    turn = np.outer(4.0 * time, [0.0, 1.0, 0.0])  # nearly two rounds
    motion.rotations[:, 0] = quaternion_multiply(
        quaternion_from_axis_angle(turn), motion.rotations[:, 0].astype(np.float64)
    )
    motion.root[:, 0] += np.sin(4 * time) / 2
    motion.root[:, 2] += np.cos(4 * time) / 2 - 0.5
    motion.root[:, 1] += 0.02 * np.sin(6 * time)
    return renamed(motion, motorica_names())


def test_a_dance_is_the_motion_it_was(tmp_path: Path) -> None:
    motion = walking()
    found = read_lda(write_lda(tmp_path / "a.expmap_30fps.pkl", motion), motion.skeleton)
    np.testing.assert_allclose(found.root, motion.root, atol=1e-5)
    then, now = motion.pose().positions, found.pose().positions
    for joint in PARENTS:
        there = then[:, motion.skeleton.index(joint)]
        np.testing.assert_allclose(now[:, found.skeleton.index(joint)], there, atol=1e-4)
    assert found.fps == 30


def test_without_a_rig_it_has_our_lengths_and_comes_to_ours(tmp_path: Path) -> None:
    motion = walking()
    found = read_lda(write_lda(tmp_path / "a.expmap_30fps.pkl", motion))
    ours = retarget(found)
    assert ours.skeleton.names == HUMANOID.names
    here, there = ours.pose().positions, motion.pose().positions
    for bone, joint in (("leftHand", "LeftHand"), ("head", "Head"), ("rightFoot", "RightFoot")):
        apart = here[:, HUMANOID.index(bone)] - there[:, motion.skeleton.index(joint)]
        assert float(np.median(np.linalg.norm(apart, axis=-1))) < 0.03


def test_what_does_not_fit_is_named(tmp_path: Path) -> None:
    path, columns = tmp_path / "a.expmap_30fps.pkl", lda_columns(walking())
    broken = {name: column.copy() for name, column in columns.items()}
    broken["Spine_beta"][7] = np.nan
    path.write_bytes(pickled_frame(broken))
    with pytest.raises(MotionError, match=r"a\.expmap_30fps\.pkl, frame 7: Spine_beta is not finite; repair"):
        read_lda(path)
    del columns["Head_alpha"]
    path.write_bytes(pickled_frame(columns))
    with pytest.raises(MotionError, match=r"a\.expmap_30fps\.pkl lacks Head_alpha and 0 more columns; give"):
        read_lda(path)
    path.write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(MotionError, match=r"a\.expmap_30fps\.pkl is refused: it would run os\.system"):
        read_lda(path)
