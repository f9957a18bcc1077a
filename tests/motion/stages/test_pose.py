import numpy as np

from echoavatar.motion.stages.pose import Pose


def test_a_pose_knows_how_many_frames_it_has() -> None:
    assert Pose(np.zeros((2, 5, 3, 4), np.float32), np.zeros((2, 5, 3), np.float32), 30.0).frames == 5
