"""Motion of SMPL, SMPL-H and SMPL-X, on one rig: the 55 joints of SMPL-X.

The rig has the rest offsets of our humanoid's bones, because the licence of the body model does not allow shipping it:
rotations are exact, positions are those of a body of 1.70 m. What a file lacks, such as fingers, rests.

A file has `poses`, axis angles in radians of 22 (body), 24 (SMPL), 52 (SMPL-H) or 55 joints, flat or (t, j, 3), or its
parts (`global_orient`, `body_pose`, ...; AMASS: `root_orient`, `pose_body`, ...), and `trans` or `transl` (t, 3) in
metres. Matrices (t, j, 3, 3) are read as well. Hand poses are absolute, as MoSh writes them: no mean hand is added.
"""

import math
import re
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
from ..kinematics.upright import of_clip, placed, righted
from .reading import reading

_Layout = Mapping[int, Collection[int]]  # the joints of the rig that an array has, by their count
_BODY_LAYOUT: _Layout = dict.fromkeys((21, 23), range(1, 22))  # SMPL has two more, which rest
_WHOLE: _Layout = {24: range(22), 22: range(22), 52: (*range(22), *range(25, 55)), 55: range(55)}
_LAYOUTS: Mapping[str, _Layout] = {
    **dict.fromkeys(("poses", "smpl_poses", "fullpose", "full_pose", "pose"), _WHOLE),
    **dict.fromkeys(("global_orient", "root_orient"), {1: range(1)}),
    **dict.fromkeys(("body_pose", "pose_body"), _BODY_LAYOUT),
    **dict.fromkeys(("jaw_pose", "pose_jaw"), {1: range(22, 23)}),
    "leye_pose": {1: range(23, 24)},
    "reye_pose": {1: range(24, 25)},
    "pose_eye": {2: range(23, 25)},
    "left_hand_pose": {15: range(25, 40)},
    "right_hand_pose": {15: range(40, 55)},
    "pose_hand": {30: range(25, 55)},
}
_PLACES = ("trans", "transl", "smpl_trans", "translation")
_RATE = re.compile("fps|frame_?rate", re.IGNORECASE)  # in the name of an array
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
    return "skeleton" not in names and any(_LAYOUTS.get(name) in (_WHOLE, _BODY_LAYOUT) for name in names)


@np.errstate(invalid="ignore", over="ignore")  # checked below
def smpl_motion(path: Path, stored: Mapping[str, np.ndarray], rig: Skeleton | None = None) -> Motion:
    """The motion in the arrays of `path`, Y up, standing on the floor; `rig` may have other offsets than `skeleton`.

    Raises:
        MotionError: an array is missing, has another shape, is not finite, or the body does not stand; names the file.
    """
    with reading(path) as notes:
        most = min(ROTATIONS, STILL_ROTATIONS + path.stat().st_size)  # bounded by the size of the file
        poses, place = _poses(stored, most, notes), next((name for name in _PLACES if name in stored), "")
        found, scale = stored[place] if place else np.zeros(3), stored.get("smpl_scaling", np.ones(1))  # of AIST++
        if found.size not in (3, 3 * len(poses)) or found.shape[-1:] != (3,):
            raise MotionError(f"{len(poses)} poses and trans {found.shape}; give a place (t, 3) for each pose")
        trans = np.broadcast_to(np.asarray(found, np.float64).reshape(-1, 3) / scale, (len(poses), 3))
        is_finite = np.isfinite(poses).all((1, 2)) & np.isfinite(trans).all(1)
        if not is_finite.all():
            raise MotionError(f"{path}, frame {np.argmin(is_finite)}: values that are not finite; repair it")
        if np.median(np.abs(poses).max((1, 2))) > 2 * np.pi:
            poses = np.radians(poses)
            notes.append("its angles are taken for degrees")
        rates = [rate for name in stored if _RATE.search(name) and (rate := np.unique(stored[name])).size == 1]
        fps = float(rates[0][0]) if rates else _ASSUMED_HZ
        notes += [] if rates else [f"it has no frame rate, and {fps:g} frames per second are assumed"]
        if not 0 < fps < 1000:
            raise MotionError(f"it says {fps:g} frames per second; write its mocap_frame_rate, such as 30")
        rig = rig or skeleton()
        rotations = quaternion_from_axis_angle(poses).astype(np.float32)
        motion = Motion(rig, rotations, trans.astype(np.float32), fps)
        stand = of_clip(motion, rig.config.vrm, has_floor=False)._replace(metres=1.0)
        motion = placed(righted(motion, stand), rig.config.vrm, notes)
        spine = motion.matrices()[:, 0, :, 1].mean(0).round(2)
        if spine[1] < _UPRIGHT:
            raise MotionError(f"the body does not stand (mean spine {spine.tolist()}); turn it upright")
        notes += stand.notes(usual=1.0) + (["it has no 'trans', so the body stays in one place"] if not place else [])
    return _on_floor(Motion(rig, motion.rotations, motion.root + rig.offsets[0], fps))


def _turns(name: str, array: np.ndarray, layout: _Layout, most: int) -> Float[np.ndarray, "t j 3"]:
    """The axis angles of an array's joints, from axis angles or matrices; raises MotionError for other shapes.

    Joints may be flattened; there may be a single frame, or an axis for a single body. At most `most` are read.
    """
    if array.size > 3 * most or (array.ndim and len(array) * 55 > most):
        raise MotionError(f"an array {array.shape} is more than {most // 55:,} frames of SMPL; cut it")
    widths = {width * count: width for count in layout for width in (3, 9)}
    fewest = 2 if array.ndim > 2 and array.shape[-2:] == (3, 3) else 1
    for axes in range(fewest, 4):  # that make a frame
        size, others = math.prod(array.shape[-axes:]), array.shape[:-axes]
        if size in widths and max(others, default=1) == math.prod(others) > 0:
            turns = np.asarray(array, np.float64).reshape(math.prod(others), -1, widths[size])
            matrices = turns.reshape(len(turns), -1, 3, 3) if widths[size] == 9 else None
            return turns if matrices is None else axis_angle_from_quaternion(quaternion_from_matrix(matrices))
    flat = ", ".join(f"(t, {3 * count})" for count in layout)
    raise MotionError(f"{name} {array.shape}; SMPL has {flat} of axis angles, or matrices; convert it")


def _poses(stored: Mapping[str, np.ndarray], most: int, notes: list[str]) -> Float[np.ndarray, "t 55 3"]:
    names = [name for name in _LAYOUTS if name in stored]
    found = dict[str, Float[np.ndarray, "t j 3"]]()
    for name in names[:1] if _LAYOUTS[names[0]] is _WHOLE else names:
        try:
            found[name] = _turns(name, stored[name], _LAYOUTS[name], most)
        except MotionError:
            if "hand" not in name:
                raise
            notes.append(f"its {name} {stored[name].shape} is left out, which may be weights of a hand model")
    whole = np.zeros((max(map(len, found.values())), 55, 3))
    for name, turns in found.items():
        if len(turns) not in (1, len(whole)):
            raise MotionError(f"{name} has {len(turns)} frames of {len(whole)}; give as many of each")
        joints = list(_LAYOUTS[name][turns.shape[1]])
        whole[:, joints] = turns[:, : len(joints)]
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
