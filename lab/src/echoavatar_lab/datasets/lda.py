"""Motorica's dances as Listen, Denoise, Action! publishes them: `NAME.expmap_30fps.pkl`, a pickled data frame each.

Columns: for each of 19 joints a rotation vector in radians (`RightFoot_alpha`, `_beta`, `_gamma`), `Hips_Yposition` in
centimetres, and three of a reference on the floor: `reference_dXposition`, `reference_dZposition` (centimetres a frame,
along its own axes) and `reference_dYrotation` (radians a frame). Hips turn with the reference. 30 frames a second, no
fingers, no toes. The files hold no bone lengths: those of a BVH of the dataset are taken where there is one, else ours,
in the T-pose.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import CheckpointError, MotionError
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from echoavatar.timing import FRAME_RATE_HZ
from echoavatar_lab.foreign.foreign_files import read_pickled_frame

SUFFIX = ".expmap_30fps.pkl"
ROOT = "Hips"
PARENTS = {
    ROOT: "",
    "Spine": ROOT,
    "Spine1": "Spine",
    "Neck": "Spine1",
    "Head": "Neck",
    **{
        side + joint: side + parent if parent in ("Shoulder", "Arm", "ForeArm", "UpLeg", "Leg") else parent
        for side in ("Left", "Right")
        for joint, parent in (
            ("Shoulder", "Spine1"),
            ("Arm", "Shoulder"),
            ("ForeArm", "Arm"),
            ("Hand", "ForeArm"),
            ("UpLeg", ROOT),
            ("Leg", "UpLeg"),
            ("Foot", "Leg"),
        )
    },
}
_OURS = {"Spine1": "chest", "UpLeg": "UpperLeg", "Leg": "LowerLeg", "Arm": "UpperArm", "ForeArm": "LowerArm"}
_REFERENCE = ("reference_dXposition", "reference_dZposition", "reference_dYrotation")


def read_lda(path: Path, skeleton: Skeleton | None = None) -> Motion:
    """A dance with the bone lengths of `skeleton`, a rig with Motorica's names, or ours.

    Raises MotionError if the file is missing, damaged, refused because it would run code, lacks a column, or holds
    values that are not finite; or the skeleton lacks a joint.
    """
    try:
        stored = read_pickled_frame(path)
    except CheckpointError as error:
        raise MotionError(str(error)) from error
    wanted = [f"{joint}_{axis}" for joint in PARENTS for axis in ("alpha", "beta", "gamma")]
    if missing := [name for name in (*wanted, f"{ROOT}_Yposition", *_REFERENCE) if name not in stored]:
        raise MotionError(f"{path} lacks {missing[0]} and {len(missing) - 1} more columns; give a {SUFFIX} of LDA")
    columns = {name: np.asarray(column, np.float64) for name, column in stored.items()}
    for name, column in columns.items():
        if not np.isfinite(column).all():
            frame = int(np.argmin(np.isfinite(column)))
            raise MotionError(f"{path}, frame {frame}: {name} is not finite; repair or leave out the file")
    rig = _rig(skeleton or HUMANOID)
    turns = np.stack([columns[name] for name in wanted], 1).reshape(-1, len(PARENTS), 3)
    rotations = quaternion_from_axis_angle(turns)
    yaw = np.cumsum([0.0, *columns["reference_dYrotation"][1:]])
    heading = quaternion_from_axis_angle(np.outer(yaw, [0.0, 1.0, 0.0]))
    rotations[:, 0] = quaternion_multiply(heading, rotations[:, 0])
    root = np.stack([*_path(yaw, *(columns[name] for name in _REFERENCE[:2])), columns[f"{ROOT}_Yposition"]], 1)
    return Motion(
        rig, rotations.astype(np.float32), (root[:, [0, 2, 1]] / 100).astype(np.float32), float(FRAME_RATE_HZ)
    )


def _path(
    yaw: Float[np.ndarray, " t"], along_x: Float[np.ndarray, " t"], along_z: Float[np.ndarray, " t"]
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Where the reference stands, from its steps along its own axes."""
    x = np.cos(yaw) * along_x + np.sin(yaw) * along_z
    z = np.cos(yaw) * along_z - np.sin(yaw) * along_x
    return np.cumsum([0.0, *x[1:]]), np.cumsum([0.0, *z[1:]])


def _rig(source: Skeleton) -> Skeleton:
    """The 19 joints with the lengths of another rig, which has them by Motorica's names or by ours."""
    bones = {name: _joint(source, name) for name in PARENTS}
    places = source.rest_positions
    offsets = [
        places[at] - (places[bones[parent]] if (parent := PARENTS[name]) else 0 * places[at])
        for name, at in bones.items()
    ]
    names = list(PARENTS)
    config = SkeletonConfig(
        names=tuple(names),
        parents=tuple(names.index(parent) if parent else -1 for parent in PARENTS.values()),
        offsets=tuple((float(x), float(y), float(z)) for x, y, z in offsets),
        tips={
            name: source.config.tips[source.names[at]]
            for name, at in bones.items()
            if source.names[at] in source.config.tips
        },
    )
    return Skeleton(config)


def _joint(source: Skeleton, name: str) -> int:
    if name in source.names:
        return source.index(name)
    side = next((side for side in ("Left", "Right") if name.startswith(side)), "")
    own = name.removeprefix(side)
    bone = side.lower() + _OURS.get(own, own) if side else _OURS.get(own, own.lower())
    try:
        return bone_map(source)[bone]
    except KeyError as error:
        raise MotionError(f"no joint of the rig is {name}; give a BVH of the Motorica Dance Dataset") from error
