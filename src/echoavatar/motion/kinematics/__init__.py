"""Skeletons and motion as geometry: rotations, forward kinematics, BVH, features, mirroring, retargeting.

May import `nn` and below. Metres, radians, Y up, character facing +Z with its left at +X, quaternions `wxyz`,
rotations relative to the parent; anything else says so in its name.
"""

from .bvh import read_bvh, write_bvh
from .features import (
    FeatureStatistics,
    MotionFrames,
    feature_size,
    from_features,
    join_parts,
    measure_features,
    part_sizes,
    split_parts,
    to_features,
)
from .forward import Pose, forward_kinematics
from .mirror import mirror_features, mirror_rotations
from .motion import Motion
from .skeleton import HUMANOID, Skeleton, SkeletonConfig

__all__ = [
    "HUMANOID",
    "FeatureStatistics",
    "Motion",
    "MotionFrames",
    "Pose",
    "Skeleton",
    "SkeletonConfig",
    "feature_size",
    "forward_kinematics",
    "from_features",
    "join_parts",
    "measure_features",
    "mirror_features",
    "mirror_rotations",
    "part_sizes",
    "read_bvh",
    "split_parts",
    "to_features",
    "write_bvh",
]
