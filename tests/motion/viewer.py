import numpy as np
import torch

from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.motion_chunk import MotionChunk


def off_viewer(motion: MotionChunk) -> np.ndarray:
    """Radians between the direction of the head and the viewer, frame by frame."""
    pose = Motion(HUMANOID, motion.rotations, motion.root, 30).pose()
    x, y, z = pose.rotations[:, HUMANOID.index("head"), :, 2].unbind(-1)
    return torch.atan2(torch.hypot(x, y), z).numpy()
