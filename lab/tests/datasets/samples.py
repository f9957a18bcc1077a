"""Synthetic recordings with the layout of published datasets, whose licences keep them out of the repository."""

import pickle  # noqa: TID251  # to write what LDA publishes
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from echoavatar.models.audio import write_wav
from echoavatar.motion.formats import write_bvh
from echoavatar.motion.kinematics import HUMANOID, Motion, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.named_bones import finger_bones
from echoavatar.motion.kinematics.rigs import bone_map
from echoavatar.motion.kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_conjugate,
    quaternion_from_axis_angle,
    quaternion_multiply,
)

SHARED = Path(__file__).parents[3] / "../shared/data/motion_eval_only"
SIDES = (("left", "Left"), ("right", "Right"))


def gesture(seconds: float = 3.0, fps: float = 30.0, *, fingers: float = 0.5) -> Motion:
    """A standing figure whose arms hang and swing in front; fingers curl by up to `fingers` radians."""
    time = np.arange(round(seconds * fps)) / fps
    turns = np.zeros((len(time), HUMANOID.joints, 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turns[:, HUMANOID.index(f"{side}UpperArm"), 2] = -sign * (1.1 + 0.1 * np.sin(3 * time))
        turns[:, HUMANOID.index(f"{side}LowerArm"), 1] = -sign * (1.0 + 0.7 * np.sin(2.5 * time + sign))
        for bones in finger_bones(side).values():
            for bone in bones[1:]:
                turns[:, HUMANOID.index(bone), 2] = -sign * fingers * (1 + np.sin(2 * time)) / 2
    turns[:, HUMANOID.index("spine"), 0] = 0.05 * np.sin(time)
    rotations = quaternion_from_axis_angle(turns).astype(np.float32)
    root = np.tile(HUMANOID.rest_positions[0], (len(time), 1))
    return Motion(HUMANOID, rotations, root.astype(np.float32), fps)


def motorica_names() -> dict[str, str]:
    """Our bones by their names in the Motorica Dance Dataset: two spine bones, no upper chest."""
    names = {"hips": "Hips", "spine": "Spine", "chest": "Spine1", "neck": "Neck", "head": "Head"}
    limbs = {
        "Shoulder": "Shoulder",
        "UpperArm": "Arm",
        "LowerArm": "ForeArm",
        "Hand": "Hand",
        "UpperLeg": "UpLeg",
        "LowerLeg": "Leg",
        "Foot": "Foot",
        "Toes": "ToeBase",
    }
    for side, own in SIDES:
        names |= {f"{side}{bone}": own + theirs for bone, theirs in limbs.items()}
        for digit, bones in finger_bones(side).items():
            named = "Pinky" if digit == "Little" else digit
            names |= {bone: f"{own}Hand{named}{k}" for k, bone in enumerate(bones, start=1)}
    return names


def renamed(motion: Motion, names: dict[str, str]) -> Motion:
    """The motion with renamed joints; joints without a new name are removed and their children move up.

    Only joints without rotation may be removed.
    """
    rig, bones = motion.skeleton, bone_map(motion.skeleton)
    kept = sorted(bones[bone] for bone in names)
    joint_names = {bones[bone]: name for bone, name in names.items()}
    parents, offsets = [], []
    for joint in kept:
        offset, parent = np.array(rig.config.offsets[joint]), rig.parents[joint]
        while parent >= 0 and parent not in joint_names:
            offset, parent = offset + rig.config.offsets[parent], rig.parents[parent]
        parents.append(-1 if parent < 0 else kept.index(parent))
        offsets.append(tuple(float(x) for x in offset))
    config = SkeletonConfig(
        names=tuple(joint_names[joint] for joint in kept),
        parents=tuple(parents),
        offsets=tuple(offsets),
        tips={joint_names[j]: rig.config.tips[rig.names[j]] for j in kept if rig.names[j] in rig.config.tips},
    )
    return Motion(Skeleton(config), motion.rotations[:, kept], motion.root, motion.fps)


def speech(seconds: float, rate: int = 24_000) -> np.ndarray:
    """A buzz in bursts like syllables, three per second."""
    time = np.arange(round(seconds * rate)) / rate
    buzz = sum(np.sin(2 * np.pi * 140 * k * time) / k for k in range(1, 12))
    return (0.2 * buzz * np.clip(np.sin(2 * np.pi * 3 * time), 0, 1)).astype(np.float32)


def write_motion(path: Path, motion: Motion) -> Path:
    """Write a BVH file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bvh(path, motion.skeleton, motion.rotations, motion.root, motion.fps)
    return path


def write_pair(path: Path, seconds: float = 3.0, *, fps: float = 60.0, rate: int = 16_000) -> Path:
    """Write `path` (.bvh) and the wav beside it."""
    write_motion(path, gesture(seconds, fps))
    write_wav(path.with_suffix(".wav"), speech(seconds, rate), rate=rate)
    return path


def write_beat2(folder: Path, name: str, seconds: float = 3.0, *, is_z_up: bool = False) -> Path:
    """Write one recording of BEAT2: `gesture` as SMPL-X npz at 30 fps, and a 16 kHz wav."""
    from echoavatar.motion.formats.smpl import skeleton
    from echoavatar.motion.kinematics.rotations import axis_angle_from_quaternion, quaternion_multiply

    motion, rig = gesture(seconds), skeleton()
    quaternions = np.zeros((motion.frames, rig.joints, 4), np.float32)
    quaternions[..., 0] = 1
    for bone, joint in rig.config.vrm.items():
        quaternions[:, joint] = motion.rotations[:, HUMANOID.index(bone)]
    trans = motion.root - motion.root[0] + [0.0, 1.2, 0.0]  # the origin of SMPL-X is not on the floor
    if is_z_up:
        quarter = np.array([np.pi / 2, 0.0, 0.0])
        up = np.broadcast_to(quaternion_from_axis_angle(quarter), (motion.frames, 4))
        quaternions[:, 0] = quaternion_multiply(up, quaternions[:, 0])
        trans = trans[:, [0, 2, 1]] * [1, -1, 1]
    poses = axis_angle_from_quaternion(quaternions).reshape(motion.frames, 165)
    path = folder / "smplxflame_30" / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, poses=poses, trans=trans, betas=np.zeros(300), mocap_frame_rate=30, gender=np.array("neutral"))
    (folder / "wave16k").mkdir(exist_ok=True)
    write_wav(folder / "wave16k" / f"{name}.wav", speech(seconds, 16_000), rate=16_000)
    return path


def pickled_frame(columns: Mapping[str, np.ndarray], *, is_old: bool = False) -> bytes:
    """A data frame as pandas pickles it, without pandas; `is_old`: as before pandas 1.3."""
    values, names = np.stack(list(columns.values())).astype(np.float64), np.array(list(columns), object)

    def plain(value: object) -> bytes:
        return pickle.dumps(value, protocol=2)[2:-1]

    def text(value: str) -> bytes:
        return b"X" + len(value).to_bytes(4, "little") + value.encode()

    index = (
        b"cpandas.core.indexes.base\n_new_Index\n(cpandas.core.indexes.base\nIndex\n}(" + text("data") + plain(names)
    )
    index += text("name") + b"NutR"
    places = b"cbuiltins\nslice\n" + plain((0, len(names), 1)) + b"R"
    manager = b"cpandas.core.internals.managers\nBlockManager\n"
    if is_old:
        block = b"}(" + text("values") + plain(values) + text("mgr_locs") + places + b"u"
        kept = b"}(" + text("axes") + b"](" + index + index + b"e" + text("blocks") + b"](" + block + b"eu"
        manager += b")\x81(]]]}" + text("0.14.1") + kept + b"stb"
    else:
        block = b"cpandas._libs.internals\n_unpickle_block\n(" + plain(values) + places + b"K\x02tR"
        manager += b"((" + block + b"t](" + index + index + b"etR"
    return b"\x80\x02cpandas.core.frame\nDataFrame\n)\x81}" + text("_mgr") + manager + b"sb."


def lda_columns(motion: Motion) -> dict[str, np.ndarray]:
    """Motion on Motorica's names at 30 fps as LDA's columns; the reference is under the hips and turns with them."""
    from echoavatar_lab.datasets.lda import PARENTS

    rig, rotations = motion.skeleton, motion.rotations.astype(np.float64)
    hips = rotations[:, 0]
    yaw = np.unwrap(2 * np.arctan2(hips[:, 2], hips[:, 0]), period=2 * np.pi)
    yaw = yaw - yaw[0]
    heading = quaternion_from_axis_angle(np.outer(yaw, [0.0, 1.0, 0.0]))
    local = rotations.copy()
    local[:, 0] = quaternion_multiply(quaternion_conjugate(heading), rotations[:, 0])
    found = {}
    for joint in PARENTS:
        turns = axis_angle_from_quaternion(local[:, rig.index(joint)])
        found |= {f"{joint}_{axis}": turns[:, n] for n, axis in enumerate(("alpha", "beta", "gamma"))}
    step = 100 * np.diff(motion.root.astype(np.float64), axis=0, prepend=motion.root[:1])
    found["Hips_Yposition"] = 100 * motion.root[:, 1].astype(np.float64)
    found["reference_dXposition"] = np.cos(yaw) * step[:, 0] - np.sin(yaw) * step[:, 2]
    found["reference_dZposition"] = np.cos(yaw) * step[:, 2] + np.sin(yaw) * step[:, 0]
    found["reference_dYrotation"] = np.diff(yaw, prepend=yaw[0])
    return found


def write_lda(path: Path, motion: Motion) -> Path:
    """Write a dance as LDA publishes it, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickled_frame(lda_columns(motion)))
    return path
