"""Motion of SMPL, SMPL-H and SMPL-X, on one rig: the 55 joints of SMPL-X.

The rig has the rest offsets of our humanoid's bones, because the licence of the body model does not allow shipping it:
rotations are exact, positions are those of a body of 1.70 m. What a file lacks, such as fingers, rests.

A file has `poses`, axis angles in radians of 22 (body), 24 (SMPL), 52 (SMPL-H) or 55 joints, flat or (t, j, 3), or its
parts (`global_orient`, `body_pose`, ...; AMASS: `root_orient`, `pose_body`, ...), and `trans` or `transl` (t, 3) in
metres. Matrices (t, j, 3, 3) are read as well. Hand poses are absolute, as MoSh writes them: no mean hand is added.
"""

import logging
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import ROTATIONS, STILL_ROTATIONS

from ..kinematics.motion import Motion
from ..kinematics.named_bones import finger_bones
from ..kinematics.rotations import axis_angle_from_quaternion, quaternion_from_axis_angle, quaternion_from_matrix
from ..kinematics.skeleton import HUMANOID, Skeleton, SkeletonConfig
from ..kinematics.upright import of_clip, righted

_log = logging.getLogger(__name__)
_POSES = ("poses", "smpl_poses", "fullpose", "full_pose", "pose")
_JOINTS = {22: range(22), 24: range(22), 52: (*range(22), *range(25, 55)), 55: range(55)}  # of the rig, by their count
_PARTS = {  # the first joint of the rig, and how many
    "global_orient": (0, 1),
    "root_orient": (0, 1),
    "body_pose": (1, 21),
    "pose_body": (1, 21),
    "jaw_pose": (22, 1),
    "pose_jaw": (22, 1),
    "leye_pose": (23, 1),
    "reye_pose": (24, 1),
    "pose_eye": (23, 2),
    "left_hand_pose": (25, 15),
    "right_hand_pose": (40, 15),
    "pose_hand": (25, 30),
}
_PLACES = ("trans", "transl", "smpl_trans", "translation")
_RATES = ("mocap_frame_rate", "mocap_framerate", "fps", "frame_rate", "framerate")
_ASSUMED_HZ = 30.0
_UPRIGHT = 0.6  # least height of the mean direction of the spine
_BODY = (  # name:VRM bone; each hangs from what its bone hangs from
    "pelvis:hips left_hip:leftUpperLeg right_hip:rightUpperLeg spine1:spine left_knee:leftLowerLeg"
    " right_knee:rightLowerLeg spine2:chest left_ankle:leftFoot right_ankle:rightFoot spine3:upperChest"
    " left_foot:leftToes right_foot:rightToes neck:neck left_collar:leftShoulder right_collar:rightShoulder head:head"
    " left_shoulder:leftUpperArm right_shoulder:rightUpperArm left_elbow:leftLowerArm right_elbow:rightLowerArm"
    " left_wrist:leftHand right_wrist:rightHand"
)
_FACE = {  # from the head joint, metres
    "jaw": (0.0, 0.0, 0.02),
    "left_eye_smplhf": (0.03, 0.07, 0.07),
    "right_eye_smplhf": (-0.03, 0.07, 0.07),
}
_DIGITS = {"index": "Index", "middle": "Middle", "pinky": "Little", "ring": "Ring", "thumb": "Thumb"}


def skeleton() -> Skeleton:
    """The 55 joints at the positions of our humanoid."""
    bones = dict(pair.split(":") for pair in _BODY.split()) | dict.fromkeys(_FACE, "")
    for side in ("left", "right"):
        for digit, ours in _DIGITS.items():
            bones |= {f"{side}_{digit}{k}": bone for k, bone in enumerate(finger_bones(side)[ours], start=1)}
    config = HUMANOID.config
    by_bone = {bone: joint for joint, bone in enumerate(bones.values()) if bone}
    over = {bone: (*config.names, "")[config.parents[HUMANOID.index(bone)]] for bone in by_bone}
    return Skeleton(
        SkeletonConfig(
            names=tuple(bones),
            parents=tuple(by_bone.get(over.get(bone, "head"), -1) for bone in bones.values()),
            offsets=tuple(
                config.offsets[HUMANOID.index(bone)] if bone else _FACE[name] for name, bone in bones.items()
            ),
            tips={name: config.tips[bone] for name, bone in bones.items() if bone in config.tips},
            vrm=by_bone,
        )
    )


def is_smpl(names: Collection[str]) -> bool:
    """Whether a file with arrays of these names has motion of SMPL."""
    return "skeleton" not in names and any(name in names for name in (*_POSES, "body_pose", "pose_body"))


@np.errstate(invalid="ignore", over="ignore")  # looked for below
def smpl_motion(path: Path, stored: Mapping[str, np.ndarray], rig: Skeleton | None = None) -> Motion:
    """The motion in the arrays of `path`, Y up, standing on the floor; `rig` has other places than `skeleton`.

    Raises:
        MotionError: an array is missing, has another shape, is not finite, or the body does not stand; names the file.
    """
    poses, found = _poses(path, stored), _first(path, stored, _PLACES)
    trans = np.zeros((len(poses), 3)) if found is None else found
    if (scale := _first(path, stored, ("smpl_scaling",))) is not None:  # AIST++
        trans = trans / scale
    if trans.shape != (len(poses), 3):
        raise MotionError(f"{path}: {len(poses)} poses and trans {trans.shape}; give a place (t, 3) for each pose")
    if not (np.isfinite(poses).all() and np.isfinite(trans).all()):
        bad = int(np.flatnonzero(~(np.isfinite(poses).all((1, 2)) & np.isfinite(trans).all(1)))[0])
        raise MotionError(f"{path}, frame {bad}: values that are not finite; repair or leave out the file")
    rate = _first(path, stored, _RATES)
    fps = _ASSUMED_HZ if rate is None or rate.size != 1 else rate.item()
    if not 0 < fps < 1000:
        raise MotionError(f"{path} says {fps:g} frames per second; write its mocap_frame_rate, such as 30")
    rig = rig or skeleton()
    rotations = quaternion_from_axis_angle(poses).astype(np.float32)
    motion = Motion(rig, rotations, trans.astype(np.float32), fps)
    stand = of_clip(motion, rig.config.vrm, has_floor=False)._replace(metres=1.0)
    motion = righted(motion, stand)
    spine = motion.matrices()[:, 0, :, 1].mean(0).round(2)
    if spine[1] < _UPRIGHT:
        raise MotionError(f"{path}: the body does not stand (mean spine {spine.tolist()}); turn it upright")
    notes = stand.notes(usual=1.0) + (["it has no 'trans', so the body stays in one place"] if found is None else [])
    notes += [f"it has no frame rate, and {fps:g} frames per second are assumed"] if rate is None else []
    if notes:
        _log.warning("%s: %s", path, "; ".join(notes))
    return _on_floor(Motion(rig, motion.rotations, motion.root + rig.offsets[0], fps))


def _first(path: Path, stored: Mapping[str, np.ndarray], names: Collection[str]) -> Float[np.ndarray, "..."] | None:
    return next((_numbers(path, stored[name]) for name in names if name in stored), None)


def _numbers(path: Path, array: np.ndarray) -> Float[np.ndarray, "..."]:
    """The array in double precision, if its file has room for as many poses."""
    most = min(ROTATIONS, STILL_ROTATIONS + path.stat().st_size)
    if array.size > 3 * most or (array.ndim and len(array) * 55 > most):
        raise MotionError(f"{path}: an array {array.shape} is more than {most // 55:,} frames of SMPL; cut it")
    numbers = np.asarray(array, np.float64)
    if numbers.ndim < 3 or numbers.shape[-2:] != (3, 3):
        return numbers
    return axis_angle_from_quaternion(quaternion_from_matrix(numbers))


def _poses(path: Path, stored: Mapping[str, np.ndarray]) -> Float[np.ndarray, "t 55 3"]:
    given = _first(path, stored, _POSES)
    if given is not None:
        flat = given.reshape(len(given), -1) if given.ndim > 1 and given.size else np.zeros((1, 1))
        joints = _JOINTS.get(flat.shape[1] // 3) if flat.shape[1] % 3 == 0 else None
        if joints is None:
            raise MotionError(f"{path}: poses {given.shape}; SMPL has (t, 72), SMPL-H (t, 156), and SMPL-X (t, 165)")
        whole = np.zeros((len(flat), 55, 3))
        whole[:, list(joints)] = flat.reshape(len(flat), -1, 3)[:, : len(joints)]
        return whole
    parts = {name: _numbers(path, stored[name]) for name in _PARTS if name in stored}
    frames = max(map(len, parts.values()))
    whole = np.zeros((frames, 55, 3))
    for name, part in parts.items():
        first, count = _PARTS[name]
        if part.size >= 3 * count * frames > 0 and len(part) == frames:  # fewer: weights of a hand model
            whole[:, first : first + count] = part.reshape(frames, -1, 3)[:, :count]
        elif first < 2:
            raise MotionError(f"{path}: {name} {part.shape}; SMPL has (t, {3 * count}) for {frames} frames")
    return whole


def _on_floor(motion: Motion) -> Motion:
    """Shift the motion so that the lower ankle is at or below its rest height for a tenth of the time.

    The origin of SMPL-X is not on the floor.
    """
    ankles = motion.skeleton.indices(("left_ankle", "right_ankle"))
    low = np.quantile(motion.pose().positions[:, ankles, 1].min(1), 0.1)
    rest = float(motion.skeleton.rest_positions[ankles, 1].mean())
    root = motion.root + np.array([0.0, rest - low, 0.0], np.float32)
    return Motion(motion.skeleton, motion.rotations, root, motion.fps)
