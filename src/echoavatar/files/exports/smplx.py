"""Write SMPL-X parameters in the layout of BEAT2's `smplxflame_30`, for research tools.

The rig has SMPL-X's 55 joints in their order, but the rest offsets of our humanoid's bones, because the licence of the
body model does not allow shipping it: rotations are exact, positions are those of a body of 1.70 m. Each joint takes
the rotation of our bone. `trans` is the pelvis position minus its rest position, Y up. The shape is the mean body
(`betas` are 0); a user with the body model can set another. The jaw follows `jawOpen`. No map from ARKit's curves to
FLAME's expressions is published, so `expressions` are 0.
"""

import io
from pathlib import Path

import numpy as np
import torch

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.rigs import bone_map, finger_bones
from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion
from echoavatar.whole_file import write_whole

from .take import Take

_BODY = (  # name, parent, VRM bone
    ("pelvis", -1, "hips"),
    ("left_hip", 0, "leftUpperLeg"),
    ("right_hip", 0, "rightUpperLeg"),
    ("spine1", 0, "spine"),
    ("left_knee", 1, "leftLowerLeg"),
    ("right_knee", 2, "rightLowerLeg"),
    ("spine2", 3, "chest"),
    ("left_ankle", 4, "leftFoot"),
    ("right_ankle", 5, "rightFoot"),
    ("spine3", 6, "upperChest"),
    ("left_foot", 7, "leftToes"),
    ("right_foot", 8, "rightToes"),
    ("neck", 9, "neck"),
    ("left_collar", 9, "leftShoulder"),
    ("right_collar", 9, "rightShoulder"),
    ("head", 12, "head"),
    ("left_shoulder", 13, "leftUpperArm"),
    ("right_shoulder", 14, "rightUpperArm"),
    ("left_elbow", 16, "leftLowerArm"),
    ("right_elbow", 17, "rightLowerArm"),
    ("left_wrist", 18, "leftHand"),
    ("right_wrist", 19, "rightHand"),
    ("jaw", 15, ""),
    ("left_eye_smplhf", 15, ""),
    ("right_eye_smplhf", 15, ""),
)
_FACE = {  # from the head joint, metres
    "jaw": (0.0, 0.0, 0.02),
    "left_eye_smplhf": (0.03, 0.07, 0.07),
    "right_eye_smplhf": (-0.03, 0.07, 0.07),
}
_DIGITS = {"index": "Index", "middle": "Middle", "pinky": "Little", "ring": "Ring", "thumb": "Thumb"}


def _table() -> list[tuple[str, int, str]]:
    rows = list(_BODY)
    for side, wrist in (("left", 20), ("right", 21)):
        bones = finger_bones(side)
        for digit, ours in _DIGITS.items():
            for k, bone in enumerate(bones[ours], start=1):
                rows.append((f"{side}_{digit}{k}", wrist if k == 1 else len(rows) - 1, bone))
    return rows


def skeleton() -> Skeleton:
    """The 55 joints at the positions of our humanoid."""
    rows, rest = _table(), HUMANOID.rest_positions.numpy()
    head = rest[HUMANOID.index("head")]
    places = [rest[HUMANOID.index(bone)] if bone else head + np.array(_FACE[name]) for name, _, bone in rows]
    offsets = [places[j] - (places[parent] if parent >= 0 else 0) for j, (_, parent, _) in enumerate(rows)]
    return Skeleton(
        SkeletonConfig(
            names=tuple(name for name, _, _ in rows),
            parents=tuple(parent for _, parent, _ in rows),
            offsets=tuple((float(x), float(y), float(z)) for x, y, z in offsets),
            tips={name: HUMANOID.config.tips[bone] for name, _, bone in rows if bone in HUMANOID.config.tips},
            vrm={bone: j for j, (_, _, bone) in enumerate(rows) if bone},
        )
    )


JAW_RADIANS = 0.35  # a wide open jaw
_JAW = 22
_EXPRESSIONS = 100


def write_smplx(path: Path, take: Take) -> None:
    """Write a take on our rig.

    Raises:
        MotionError: the file cannot be written.
    """
    motion = take.on_humanoid().motion
    rig = skeleton()
    theirs, ours = bone_map(rig), bone_map(motion.skeleton)
    turns = axis_angle_from_quaternion(torch.from_numpy(motion.rotations.astype(np.float64))).numpy()
    poses = np.zeros((motion.frames, rig.joints, 3))
    for bone, joint in theirs.items():
        poses[:, joint] = turns[:, ours[bone]]
    if take.face is not None:
        poses[:, _JAW, 0] = JAW_RADIANS * take.face[:, ARKIT_NAMES.index("jawOpen")]
    arrays = {
        "betas": np.zeros(300, np.float32),
        "poses": poses.reshape(motion.frames, -1).astype(np.float32),
        "expressions": np.zeros((motion.frames, _EXPRESSIONS), np.float32),
        "trans": (motion.root - rig.offsets[0].numpy()).astype(np.float32),
        "model": np.array("smplx2020"),
        "gender": np.array("neutral"),
        "mocap_frame_rate": np.array(motion.fps),
    }
    packed = io.BytesIO()
    np.savez_compressed(packed, allow_pickle=False, **arrays)
    write_whole(path, packed.getvalue(), error=MotionError)
