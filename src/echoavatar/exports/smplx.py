"""SMPL-X parameters in the layout of BEAT2's `smplxflame_30`, for tools of the research world.

Rotations are those of our bones on the 55 joints; `trans` is the pelvis less its rest place, Y up. Shape is the mean
body (`betas` 0): who has the body model gives it their own. The jaw opens with `jawOpen`; FLAME's expression space has
no published map from ARKit's, so `expressions` are 0.
"""

from pathlib import Path

import numpy as np
import torch

from ..datasets.smplx import skeleton
from ..errors import MotionError
from ..face.arkit import ARKIT_NAMES
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import axis_angle_from_quaternion
from .take import Take

SUFFIX = ".smplx.npz"
JAW_RADIANS = 0.35  # of a jaw that is wide open
_JAW = 22
_FACE = 100


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
        "expressions": np.zeros((motion.frames, _FACE), np.float32),
        "trans": (motion.root - rig.offsets[0].numpy()).astype(np.float32),
        "model": np.array("smplx2020"),
        "gender": np.array("neutral"),
        "mocap_frame_rate": np.array(motion.fps),
    }
    partial = path.with_name(path.name + ".part")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        partial.replace(path)
    except OSError as error:
        raise MotionError(f"{path} cannot be written ({error.strerror}); choose another place") from error
    finally:
        partial.unlink(missing_ok=True)
