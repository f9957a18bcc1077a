import numpy as np

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID, Motion
from echoavatar.motion.motion_chunk import MotionChunk


def off_viewer(motion: MotionChunk) -> np.ndarray:
    """Radians between the direction of the head and the viewer, frame by frame."""
    pose = Motion(HUMANOID, motion.rotations, motion.root, 30).pose()
    x, y, z = np.moveaxis(pose.rotations[:, HUMANOID.index("head"), :, 2], -1, 0)
    return np.arctan2(np.hypot(x, y), z)


def eyes_off_viewer(motion: MotionChunk) -> np.ndarray:
    """Radians between where the eyes of our character look and the viewer, frame by frame: the mean of both eyes."""
    pose = Motion(HUMANOID, motion.rotations, motion.root, 30).pose()
    head, angles = pose.rotations[:, HUMANOID.index("head")], []
    for side, leftwards, rightwards in (("Left", "Out", "In"), ("Right", "In", "Out")):
        look = {
            way: motion.face[:, ARKIT_NAMES.index(f"eyeLook{way}{side}")]
            for way in ("Up", "Down", leftwards, rightwards)
        }
        yaw = np.radians(30) * (look[leftwards] - look[rightwards])
        pitch = np.radians(30) * (look["Up"] - look["Down"])
        ahead = np.stack([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)], 1)
        angles.append(np.arccos(np.clip(np.einsum("tij,tj->ti", head, ahead)[:, 2], -1, 1)))
    return np.mean(angles, axis=0)
