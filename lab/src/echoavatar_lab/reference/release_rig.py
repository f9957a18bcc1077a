"""The rig of the release's character: bones, feature conventions, the rule that keeps hands off the body, statistics.

Joint names and the rule for hands are facts about the published software; offsets and matrices come from the user's
copy. The skeleton is converted to our axes and metres here. Features are converted while motion streams
(`pipeline.rig`).

Of the 531 standard deviations of the motion statistics 154 are zero or noise (1e-8 to 6e-5), because their joints never
move. Dividing by them would amplify float noise up to ten million times. So these channels are 0 when normalised and
their mean when decoded.
"""

from collections.abc import Sequence

import numpy as np
import torch

from echoavatar.engine.pipeline.foreign_rig import Matrix, RigConfig
from echoavatar.errors import CheckpointError
from echoavatar.motion.ik import SwingConfig
from echoavatar.motion.kinematics import Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.features import TRAVEL_SIZE, travel_slice
from echoavatar_lab.data.feature_statistics import CONSTANT_STD, FeatureStatistics

CM = 0.01
AXES: Matrix = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))  # theirs: Z up, facing -Y, left +X
JOINTS = 88
_SWING_CM = ((-80, 22), (-40, 22), (-5, 21), (0, 21), (10, 20), (30, 16), (40, 35), (55, 35), (80, 35))
_SPINE = {
    "hips": "Root_M",
    "spine": "Spine1_M",
    "chest": "Spine1Part1_M",
    "upperChest": "Chest_M",
    "neck": "Neck_M",
    "head": "Head_M",
}
_LIMBS = {
    "Shoulder": "Scapula",
    "UpperArm": "Shoulder",
    "LowerArm": "Elbow",
    "Hand": "Wrist",
    "UpperLeg": "Hip",
    "LowerLeg": "Knee",
    "Foot": "Ankle",
    "Toes": "Toes",
}
_DIGITS = {"Thumb": "Thumb", "Index": "Index", "Middle": "Middle", "Ring": "Ring", "Little": "Pinky"}


def skeleton_config(
    names: Sequence[str], parents: Sequence[int], offsets: np.ndarray, *, origin: str
) -> SkeletonConfig:
    """The rig in metres and our axes, with parts, feet and VRM map. `offsets` (j, 3) are in the release's centimetres.

    Raises CheckpointError if a required bone is missing, or the joints form no tree.
    """
    names, bones = tuple(names), bones_by_name()
    missing = sorted(set(bones.values()) - set(names))
    if missing or len(names) != JOINTS:
        what = f"it lacks {', '.join(missing[:6])}" if missing else f"it has {len(names)} joints, not {JOINTS}"
        raise CheckpointError(f"{origin} is not the rig of the release: {what}; download it again")
    ours = np.round(offsets.astype(np.float64) @ np.array(AXES, np.float64).T * CM, 9)
    where = {name: joint for joint, name in enumerate(names)}
    tips = {}
    for side in "LR":
        for digit in _DIGITS.values():
            tips[f"{digit}Finger3_{side}"] = _triple(ours[where[f"{digit}Finger4_{side}"]])
        tips[f"Toes_{side}"] = _triple(ours[where[f"ToesEnd_{side}"]])
    try:
        return SkeletonConfig(
            names=names,
            parents=tuple(int(parent) for parent in parents),
            offsets=tuple(_triple(row) for row in ours),
            parts=_parts(names, [int(parent) for parent in parents]),
            mirror=tuple(where.get(_other_side(name), joint) for joint, name in enumerate(names)),
            feet=tuple(where[name] for name in ("Ankle_L", "Toes_L", "Ankle_R", "Toes_R")),
            tips=tips,
            vrm={bone: where[name] for bone, name in bones.items()},
        )
    except ValueError as error:
        raise CheckpointError(f"{origin} is not a skeleton: {error}; download it again") from error


def rig_config(skeleton: SkeletonConfig, rest: np.ndarray, unity: np.ndarray) -> RigConfig:
    """Conventions, the rule for hands, and for each joint M = T A^-1 from its rest matrix A and its transform T."""
    where = {name: joint for joint, name in enumerate(skeleton.names)}
    try:
        transforms = unity @ np.linalg.inv(rest)
    except np.linalg.LinAlgError as error:
        raise CheckpointError("a rest matrix of the release cannot be inverted; download it again") from error
    return RigConfig(
        axes=AXES,
        metres_per_unit=CM,
        up=2,
        swing=SwingConfig(profile=tuple((z * CM, tau * CM) for z, tau in _SWING_CM), reach=1.5, up=1, snap=1e-6),
        arms=tuple((where[f"Shoulder_{side}"], where[f"Wrist_{side}"]) for side in "RL"),
        unity=tuple((_triple(m[0]), _triple(m[1]), _triple(m[2])) for m in transforms),
    )


def bones_by_name() -> dict[str, str]:
    """VRM bone to joint name."""
    table = dict(_SPINE)
    for side, end in (("left", "L"), ("right", "R")):
        table |= {f"{side}{bone}": f"{name}_{end}" for bone, name in _LIMBS.items()}
        for digit, name in _DIGITS.items():
            bones = ("Metacarpal", "Proximal", "Distal") if digit == "Thumb" else ("Proximal", "Intermediate", "Distal")
            table |= {f"{side}{digit}{bone}": f"{name}Finger{k}_{end}" for k, bone in enumerate(bones, start=1)}
    return table


def _parts(names: Sequence[str], parents: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Joints of the lower body (root and legs), of the hands (fingers and the palm's cup), and of the upper body."""
    part: list[str] = []
    for name, parent in zip(names, parents, strict=True):
        is_leg = parent < 0 or name.startswith("Hip_") or (parent > 0 and part[parent] == "lower")
        is_hand = "Finger" in name or name.startswith("Cup_")
        part.append("lower" if is_leg else "hands" if is_hand else "upper")
    return {own: tuple(j for j, of in enumerate(part) if of == own) for own in ("lower", "upper", "hands")}


def _other_side(name: str) -> str:
    for ours, other in (("L", "R"), ("R", "L")):
        if name.endswith(f"_{ours}"):
            return name[:-1] + other
        if name.startswith(f"{ours}_"):
            return other + name[1:]
    return name


def _triple(row: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in row)
    return x, y, z


def feature_order(skeleton: Skeleton) -> list[int]:
    """For each of our channels, its index in the release's order: joints ascending, then the three of travel."""
    six = [6 * joint + k for joint in skeleton.feature_joints for k in range(6)]
    start = travel_slice(skeleton).start
    travel = [6 * skeleton.joints + k for k in range(TRAVEL_SIZE)]
    return [*six[:start], *travel, *six[start:]]


def body_statistics(skeleton: Skeleton, rows: np.ndarray) -> FeatureStatistics:
    """Statistics from the release's mean and standard deviation (2, 531)."""
    mean, std = torch.from_numpy(rows.astype(np.float32))[:, feature_order(skeleton)]
    return FeatureStatistics(mean, std, std >= CONSTANT_STD)
