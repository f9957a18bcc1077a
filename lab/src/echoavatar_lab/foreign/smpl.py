"""Read SMPL-X and SMPL motion, on the rig of `echoavatar.files.exports.smplx`.

Little is lost, because retargeting uses rotations and scales travel; foot contacts are measured on these legs. With the
user's own copy of the body model the skeleton has the speaker's joint positions (`rest_joints`). Hand poses are
absolute, as MoSh writes them: no mean hand is added.

SMPL-X: an npz holds `poses` (t, 165) axis angles in radians, `trans` (t, 3) metres, and may hold `betas` and
`mocap_frame_rate`.

SMPL: pickles as EDGE and AIST++ write them, read without running them (`pickled_arrays`). EDGE writes `smpl_poses`
(t, 72) axis angles in radians, `smpl_trans` (t, 3) metres and `full_pose`, joint positions that follow from these; 30
frames per second, Z up. AIST++ has `smpl_scaling` besides, in which `smpl_trans` is measured; 60 frames per second, Y
up. The first 22 joints of SMPL are those of SMPL-X; its two hand joints have no counterpart there and are left out, so
the fingers stay straight.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.files.exports.smplx import skeleton
from echoavatar.motion.formats.tables import NPZ_ERRORS, NpzArrays
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle, quaternion_from_matrix

from .foreign_files import read_pickled_table

UPRIGHT_SHARE = 0.6  # least component of the mean spine direction along the up axis
_Numbers = Any


def read_smplx(path: Path, *, body_model: Path | None = None) -> Motion:
    """Read SMPL-X parameters as motion with +Y up; a recording with +Z up (AMASS) is turned.

    Raises:
        MotionError: the file is missing, damaged, of another shape, not finite, or not upright.
    """
    try:
        with NpzArrays(path, MotionError) as stored:
            for key in ("poses", "trans"):
                if key not in stored:
                    raise MotionError(f"{path} lacks {key!r}; it is not SMPL-X motion")
            poses, trans = (np.asarray(stored[key], np.float64) for key in ("poses", "trans"))
            betas = np.asarray(stored["betas"], np.float64).ravel() if "betas" in stored else np.zeros(0)
            rate = next((stored[k] for k in ("mocap_frame_rate", "mocap_framerate") if k in stored), 30.0)
            fps = float(np.asarray(rate))
    except FileNotFoundError as error:
        raise MotionError(f"{path} does not exist; check the name") from error
    except NPZ_ERRORS as error:
        raise MotionError(f"{path} cannot be read as npz ({error}); fetch it again") from error
    rest = None if body_model is None else rest_joints(body_model, betas)
    return smplx_motion(path, poses, trans, fps, rest)


def smplx_motion(
    path: Path,
    poses: Float[np.ndarray, "t 165"],
    trans: Float[np.ndarray, "t 3"],
    fps: float,
    rest: Float[np.ndarray, "55 3"] | None = None,
) -> Motion:
    """Axis angles and places of the pelvis, read from `path`, as motion with +Y up that stands on the floor.

    Raises:
        MotionError: another shape, not finite, a rate that is none, or not upright; names the file.
    """
    t = len(poses)
    if poses.shape != (t, 165) or trans.shape != (t, 3) or t == 0:
        raise MotionError(
            f"{path}: poses {poses.shape} and trans {trans.shape}; SMPL-X has (t, 165) and (t, 3): 55 joints"
        )
    if not (np.isfinite(poses).all() and np.isfinite(trans).all()):
        bad = int(np.flatnonzero(~np.isfinite(np.hstack([poses, trans])).all(1))[0])
        raise MotionError(f"{path}, frame {bad}: values that are not finite; repair or leave out the file")
    if not 0 < fps < 1000:
        raise MotionError(f"{path} says {fps:g} frames per second; write its mocap_frame_rate, such as 30")
    rig = skeleton() if rest is None else _skeleton_at(rest)
    matrices = matrix_from_axis_angle(torch.from_numpy(poses.reshape(t, 55, 3)))
    matrices, trans = _with_y_up(matrices, trans, path)
    rotations = quaternion_from_matrix(matrices).numpy().astype(np.float32)
    motion = Motion(rig, rotations, (trans + rig.offsets[0].numpy()).astype(np.float32), fps)
    return _on_floor(motion)


def _skeleton_at(rest: Float[np.ndarray, "55 3"]) -> Skeleton:
    """The joints at the places of a body model, with our hips' place and the feet on the floor."""
    ours = skeleton()
    places = rest - rest[0] + HUMANOID.rest_positions[0].numpy()
    parents = np.array(ours.parents)
    offsets = places - np.where(parents[:, None] < 0, 0, places[parents])
    lowest_toes = places[ours.indices(("left_foot", "right_foot")), 1].min()
    offsets[0, 1] -= lowest_toes - float(HUMANOID.rest_positions[HUMANOID.index("leftToes"), 1])
    return Skeleton(ours.config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist()))}))


def _with_y_up(matrices: torch.Tensor, trans: _Numbers, path: Path) -> tuple[torch.Tensor, _Numbers]:
    """Turn the motion so that the mean direction of the spine is +Y."""
    spine = matrices[:, 0, :, 1].mean(0)
    if float(spine[1]) >= UPRIGHT_SHARE:
        return matrices, trans
    if float(spine[2]) < UPRIGHT_SHARE:
        raise MotionError(
            f"{path}: the body stands neither along Y nor along Z (mean spine {spine.numpy().round(2).tolist()});"
            " turn it upright"
        )
    turn = matrix_from_axis_angle(torch.tensor([-np.pi / 2, 0.0, 0.0], dtype=matrices.dtype))
    matrices = matrices.clone()
    matrices[:, 0] = turn @ matrices[:, 0]
    return matrices, trans @ turn.numpy().T


def _on_floor(motion: Motion) -> Motion:
    """Shift the motion so that the lower ankle is at or below its rest height for a tenth of the time.

    The origin of SMPL-X is not on the floor.
    """
    ankles = motion.skeleton.indices(("left_ankle", "right_ankle"))
    low = np.quantile(motion.pose().positions[:, ankles, 1].min(1).values.numpy(), 0.1)
    rest = float(motion.skeleton.rest_positions[ankles, 1].mean())
    root = motion.root + np.array([0.0, rest - low, 0.0], np.float32)
    return Motion(motion.skeleton, motion.rotations, root, motion.fps)


def rest_joints(body_model: Path, betas: Float[np.ndarray, " n"]) -> Float[np.ndarray, "55 3"]:
    """Rest positions of the joints for a body shape, from the user's own SMPLX_*.npz.

    Raises:
        MotionError: the file is missing or is not an SMPL-X model.
    """
    template, directions, regressor = _body(body_model)
    shapes = 300 if directions.shape[-1] > 300 else 10  # the others are expressions
    used = min(shapes, len(betas))
    joints: Float[np.ndarray, "55 3"] = regressor @ (template + directions[..., :used] @ betas[:used])
    return joints


@lru_cache(maxsize=2)
def _body(path: Path) -> tuple[_Numbers, _Numbers, _Numbers]:
    """Template, shape directions and joint regressor; pickled arrays of the file are not read."""
    try:
        with NpzArrays(path, MotionError) as stored:
            arrays = [np.asarray(stored[key], np.float64) for key in ("v_template", "shapedirs", "J_regressor")]
    except NPZ_ERRORS as error:
        raise MotionError(
            f"{path} is not an SMPL-X body model ({error}); pass --body-model SMPLX_NEUTRAL_2020.npz, or leave it out"
        ) from error
    template, directions, regressor = arrays
    if regressor.shape != (55, len(template)) or directions.shape[:2] != template.shape:
        raise MotionError(
            f"{path}: the joint regressor has shape {regressor.shape}, SMPL-X has 55 joints; use another model"
        )
    return template, directions, regressor


EDGE_HZ, AIST_HZ = 30.0, 60.0
SMPL_BODY = 66  # angles of the 22 joints that SMPL and SMPL-X share


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
    whole[:, :SMPL_BODY] = poses[:, :SMPL_BODY]
    return smplx_motion(path, whole, trans, AIST_HZ if is_aist else EDGE_HZ)


def _array(path: Path, stored: dict[str, object], name: str) -> np.ndarray:
    found = stored.get(name)
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiu" or found.ndim == 0:
        listed = ", ".join(str(key)[:40] for key in stored) or "nothing"
        raise MotionError(
            f"{path} has no array {name!r} (found: {listed}); motion as EDGE writes it has smpl_poses and smpl_trans"
        )
    return found.astype(np.float64)
