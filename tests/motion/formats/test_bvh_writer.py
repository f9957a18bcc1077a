"""What is written is read back."""

import numpy as np
import pytest
from tests.motion.kinematics.samples import recorded, swaying

from echoavatar.errors import MotionError
from echoavatar.motion.formats import read_bvh, write_bvh
from echoavatar.motion.kinematics import HUMANOID


@pytest.mark.parametrize("order", ["zyx", "yxz", "xzy"])
def test_written_motion_comes_back(tmp_path, order):
    motion = swaying(40, size=2.5)
    write_bvh(tmp_path / "a.bvh", HUMANOID, motion.rotations, motion.root, 30, order=order)
    back = read_bvh(tmp_path / "a.bvh")
    assert back.skeleton.names == HUMANOID.names
    assert back.fps == 30
    np.testing.assert_allclose(back.skeleton.offsets, HUMANOID.offsets, atol=1e-6, rtol=0)
    np.testing.assert_allclose(back.matrices(), motion.matrices(), atol=1e-6, rtol=0)
    np.testing.assert_allclose(back.root, motion.root, atol=1e-6)
    assert back.skeleton.config.tips.keys() == HUMANOID.config.tips.keys()


def test_written_angles_do_not_jump(tmp_path):
    """Joints that turn by up to 2.5 rad and back, sampled at 240 fps, move little between two frames."""
    motion = swaying(240, fps=240, size=1.4)
    write_bvh(tmp_path / "a.bvh", HUMANOID, motion.rotations, motion.root, 240)
    text = (tmp_path / "a.bvh").read_text().split("Frame Time:")[1].splitlines()[1:]
    table = np.array([[float(word) for word in line.split()] for line in text])[:, 3:]
    assert np.abs(np.diff(table, axis=0)).max() < 90


def test_a_place_that_cannot_be_written_leaves_nothing(tmp_path):
    motion = swaying(3)
    with pytest.raises(MotionError, match="cannot write"):
        write_bvh(tmp_path / "missing" / "a.bvh", HUMANOID, motion.rotations, motion.root, 30)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name",
    [
        "motion_permissive/hifi_apache2/idle.bvh",
        "motion_permissive/mesh2motion_cc0/greeting.bvh",
        "motion_permissive/movebox_rocketbox_mit/rb_idle_neutral.bvh",
    ],
)
def test_recorded_files_come_back(tmp_path, name):
    motion = read_bvh(recorded(name))
    write_bvh(tmp_path / "a.bvh", motion.skeleton, motion.rotations, motion.root, motion.fps)
    back = read_bvh(tmp_path / "a.bvh")
    places = motion.pose().positions
    order = [back.skeleton.index(name) for name in motion.skeleton.names]
    np.testing.assert_allclose(back.pose().positions[:, order], places, atol=1e-5, rtol=0)
