"""SMPL motion from pickles as EDGE and AIST++ write them, read without running them (`pickled_arrays`).

EDGE writes `smpl_poses` (t, 72) axis angles in radians, `smpl_trans` (t, 3) metres and `full_pose`, joint positions
that follow from these; 30 frames per second, Z up. AIST++ has `smpl_scaling` besides, in which `smpl_trans` is
measured; 60 frames per second, Y up. The first 22 joints of SMPL are those of SMPL-X; its two hand joints have no
counterpart there and are left out, so the fingers stay straight.
"""

from pathlib import Path

import numpy as np

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.kinematics import Motion
from echoavatar_lab.foreign.smplx_reader import smplx_motion

from .foreign_files import read_pickled_table

EDGE_HZ, AIST_HZ = 30.0, 60.0
BODY = 66  # angles of the 22 joints that SMPL and SMPL-X share


def read_smpl_pickle(path: Path) -> Motion:
    """Motion on SMPL-X's joints with +Y up.

    Raises:
        MotionError: the file is missing, damaged, refused because it would run code, lacks an array, or holds values
            that are not finite; names the file.
    """
    try:
        stored = read_pickled_table(path)
    except CheckpointError as error:
        raise MotionError(str(error)) from error
    poses, trans = _array(path, stored, "smpl_poses"), _array(path, stored, "smpl_trans")
    poses = poses.reshape(len(poses), -1)
    if poses.shape[1] != 72 or trans.shape != (len(poses), 3):
        raise MotionError(
            f"{path}: smpl_poses {poses.shape} and smpl_trans {trans.shape}; SMPL has (t, 72) and (t, 3): 24 joints"
        )
    is_aist = "smpl_scaling" in stored
    if is_aist:
        scale = _array(path, stored, "smpl_scaling")
        if scale.size != 1 or not scale.all():
            raise MotionError(f"{path}: smpl_scaling is {scale.tolist()}; expected one number above zero")
        trans = trans / scale.item()
    whole = np.zeros((len(poses), 165))
    whole[:, :BODY] = poses[:, :BODY]
    return smplx_motion(path, whole, trans, AIST_HZ if is_aist else EDGE_HZ)


def _array(path: Path, stored: dict[str, object], name: str) -> np.ndarray:
    found = stored.get(name)
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiu" or found.ndim == 0:
        listed = ", ".join(str(key)[:40] for key in stored) or "nothing"
        raise MotionError(
            f"{path} has no array {name!r} (found: {listed}); motion as EDGE writes it has smpl_poses and smpl_trans"
        )
    return found.astype(np.float64)
