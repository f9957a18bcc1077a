"""Write SMPL-X parameters in the layout of BEAT2's `smplxflame_30`, for research tools.

Each joint of the rig (`motion.formats.smpl`) takes the rotation of our bone. `trans` is the pelvis position minus its
rest position, Y up. The shape is the mean body (`betas` are 0); a user with the body model can set another. The jaw
follows `jawOpen`. No map from ARKit's curves to FLAME's expressions is published, so `expressions` are 0.
"""

from pathlib import Path

import numpy as np

from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.motion.formats.smpl import skeleton
from echoavatar.motion.formats.tables import write_arrays
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion

from .take import Take

JAW_RADIANS = 0.35  # a wide open jaw
_JAW = 22
_EXPRESSIONS = 100


def write_smplx(path: Path, take: Take) -> None:
    """Write a take, retargeted to our rig. Raises MotionError: the file cannot be written."""
    motion = take.on_humanoid().motion
    rig = skeleton()
    theirs, ours = bone_map(rig), bone_map(motion.skeleton)
    turns = axis_angle_from_quaternion(motion.rotations.astype(np.float64))
    poses = np.zeros((motion.frames, rig.joints, 3))
    for bone, joint in theirs.items():
        poses[:, joint] = turns[:, ours[bone]]
    if take.face is not None:
        poses[:, _JAW, 0] = JAW_RADIANS * take.face[:, ARKIT_NAMES.index("jawOpen")]
    arrays = {
        "betas": np.zeros(300, np.float32),
        "poses": poses.reshape(motion.frames, -1).astype(np.float32),
        "expressions": np.zeros((motion.frames, _EXPRESSIONS), np.float32),
        "trans": (motion.root - rig.offsets[0]).astype(np.float32),
        "model": np.array("smplx2020"),
        "gender": np.array("neutral"),
        "mocap_frame_rate": np.array(motion.fps),
    }
    write_arrays(path, arrays)
