"""Skeletons and motion as geometry: rotations, forward kinematics, features, retargeting.

May import `nn` and below. Metres, radians, Y up, character facing +Z with its left at +X, quaternions `wxyz`,
rotations relative to the parent; anything else says so in its name.

Whole clips and live stages have an implementation each, for the arrays that they have:

| | whole clips: batched arrays | live stages: compiled loops, one rotation at a time |
|---|---|---|
| rotations | `rotations` | `quaternions` |
| forward kinematics | `motion` | `ik.limbs`, for the few joints that the stages need |
| two-bone IK | `two_bone`, about a given hinge | `ik.limbs` (knee about X, elbow in its own plane) |
| retargeting | `retarget.retarget`, measured on the clip | `retarget.LiveRetarget`, measured on two rest poses |
"""

from .features import from_features, part_sizes, to_features
from .motion import Motion, Pose, forward_kinematics
from .skeleton import HUMANOID, Skeleton, SkeletonConfig, SkinWeights

__all__ = [
    "HUMANOID",
    "Motion",
    "Pose",
    "Skeleton",
    "SkeletonConfig",
    "SkinWeights",
    "forward_kinematics",
    "from_features",
    "part_sizes",
    "to_features",
]
