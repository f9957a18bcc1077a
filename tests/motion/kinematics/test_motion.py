import numpy as np
import pytest
from tests.motion.kinematics.samples import swaying

from echoavatar.errors import MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion


def test_a_piece_keeps_its_frames():
    motion = swaying(20)
    piece = motion.cut(5, 9)
    assert piece.frames == 4
    assert piece.seconds == pytest.approx(4 / 30)
    assert np.array_equal(piece.root, motion.root[5:9])


def test_pose_has_the_root_where_it_is():
    motion = swaying(3)
    np.testing.assert_allclose(motion.pose().positions[:, 0].numpy(), motion.root)


@pytest.mark.parametrize(
    ("frames", "joints", "fill", "fps", "complaint"),
    [
        (0, 52, 0.0, 30, "no frames"),
        (2, 51, 0.0, 30, "do not fit"),
        (2, 52, np.nan, 30, "not finite"),
        (2, 52, 0.0, 0, "not a frame rate"),
    ],
)
def test_what_is_no_motion_is_refused(frames, joints, fill, fps, complaint):
    rotations = np.full((frames, joints, 4), fill, np.float32)
    with pytest.raises(MotionError, match=complaint):
        Motion(HUMANOID, rotations, np.zeros((frames, 3), np.float32), fps)
