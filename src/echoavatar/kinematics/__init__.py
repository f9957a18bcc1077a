"""Rotations, skeletons and motion as geometry: forward kinematics, BVH, features, mirroring, retargeting.

May import `nn` and below. Metres, radians, Y up, character facing +Z with its left at +X, quaternions `wxyz`,
rotations relative to the parent; anything else says so in its name.
"""

from .forward import Pose, forward_kinematics
from .skeleton import HUMANOID, Skeleton, SkeletonConfig

__all__ = ["HUMANOID", "Pose", "Skeleton", "SkeletonConfig", "forward_kinematics"]
