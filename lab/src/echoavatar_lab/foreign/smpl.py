"""Read SMPL-X and SMPL motion of datasets, on the rig of `echoavatar.motion.formats.smpl`.

Little is lost, because retargeting uses rotations and scales travel; foot contacts are measured on these legs. With the
user's own copy of the body model the skeleton has the speaker's joint positions (`rest_joints`).

SMPL comes in pickles too, as EDGE and AIST++ write them, read without running them (`pickled_arrays`). EDGE writes
`smpl_poses` (t, 72), axis angles in radians, `smpl_trans` (t, 3) in metres and `full_pose`, joint positions that follow
from these; 30 frames per second, Z up. AIST++ has `smpl_scaling` besides, in which `smpl_trans` is measured; 60 frames
per second, Y up.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.formats.smpl import is_smpl, skeleton, smpl_motion
from echoavatar.motion.formats.tables import NPZ_ERRORS, NpzArrays
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton

from .foreign_files import read_pickled_table

_Numbers = Any


def read_smplx(path: Path, *, body_model: Path | None = None) -> Motion:
    """Read an npz of SMPL, SMPL-H or SMPL-X as motion with +Y up.

    Raises MotionError if the file is missing, damaged, of another shape, not finite, or not upright.
    """
    try:
        with NpzArrays(path, MotionError) as stored:
            if not is_smpl(stored):
                raise MotionError(f"{path} lacks 'poses'; it is not SMPL-X motion")
            betas = np.asarray(stored["betas"], np.float64).ravel() if body_model and "betas" in stored else np.zeros(0)
            return smpl_motion(path, stored, None if body_model is None else _rig_at(rest_joints(body_model, betas)))
    except FileNotFoundError as error:
        raise MotionError(f"{path} does not exist; check the name") from error
    except NPZ_ERRORS as error:
        raise MotionError(f"{path} cannot be read as npz ({error}); fetch it again") from error


def rest_joints(body_model: Path, betas: Float[np.ndarray, " n"]) -> Float[np.ndarray, "55 3"]:
    """Rest positions of the joints for a body shape, from the user's own SMPLX_*.npz.

    Raises MotionError if the file is missing or is not an SMPL-X model.
    """
    template, directions, regressor = _body(body_model)
    shapes = 300 if directions.shape[-1] > 300 else 10  # the others are expressions
    used = min(shapes, len(betas))
    joints: Float[np.ndarray, "55 3"] = regressor @ (template + directions[..., :used] @ betas[:used])
    return joints


def _rig_at(rest: Float[np.ndarray, "55 3"]) -> Skeleton:
    """The joints at the places of a body model, with our hips' place and the feet on the floor."""
    ours = skeleton()
    places = rest - rest[0] + HUMANOID.rest_positions[0]
    parents = np.array(ours.parents)
    offsets = places - np.where(parents[:, None] < 0, 0, places[parents])
    lowest_toes = places[ours.indices(("left_foot", "right_foot")), 1].min()
    offsets[0, 1] -= lowest_toes - float(HUMANOID.rest_positions[HUMANOID.index("leftToes"), 1])
    return ours.with_offsets(offsets)


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


def read_smpl_pickle(path: Path) -> Motion:
    """Motion on SMPL-X's joints with +Y up.

    Raises MotionError if the file is missing, damaged, refused because it would run code, lacks an array, or holds
    values that are not finite; names the file.
    """
    try:
        stored = read_pickled_table(path)
    except CheckpointError as error:
        raise MotionError(str(error)) from error
    poses, trans = _array(path, stored, "smpl_poses"), _array(path, stored, "smpl_trans")
    is_aist = "smpl_scaling" in stored
    if is_aist:
        scale = _array(path, stored, "smpl_scaling")
        if scale.size != 1 or not scale.all():
            raise MotionError(f"{path}: smpl_scaling is {scale.tolist()}; expected one number above zero")
        trans = trans / scale.item()
    return smpl_motion(path, {"poses": poses, "trans": trans, "fps": np.array(AIST_HZ if is_aist else EDGE_HZ)})


def _array(path: Path, stored: dict[str, object], name: str) -> np.ndarray:
    found = stored.get(name)
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiu" or found.ndim == 0:
        listed = ", ".join(str(key)[:40] for key in stored) or "nothing"
        raise MotionError(
            f"{path} has no array {name!r} (found: {listed}); motion as EDGE writes it has smpl_poses and smpl_trans"
        )
    return found.astype(np.float64)
