"""Map a rig's joints to the bones of the VRM humanoid set by their names.

Known are the names of VRM, Mixamo (also High Fidelity and ZeroEGGS), Unreal (Mesh2Motion), 3ds Max Biped (Rocketbox),
Bandai-Namco, Daz and Rigify (FreeMoCap, whose wrist is the tip of the lower arm). Each further rig is one more table.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from echoavatar.errors import MotionError

from .skeleton import HUMANOID, Skeleton

REQUIRED = ("hips", "head") + tuple(
    f"{side}{bone}"
    for side in ("left", "right")
    for bone in ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
)
_PREFIX = re.compile("^(mixamorig[:_]|Neo_)")
_DIGITS = ("Thumb", "Index", "Middle", "Ring", "Little")


def bone_map(skeleton: Skeleton) -> dict[str, int]:
    """VRM bone name to joint index.

    Raises:
        MotionError: the rig has no VRM map, and its joint names fit no table.
    """
    found = known_bones(skeleton)
    missing = [bone for bone in REQUIRED if bone not in found]
    if missing and not skeleton.config.vrm:
        raise MotionError(
            f"the rig with joints {', '.join(skeleton.names[:4])}, ... is not known: no joint is"
            f" {', '.join(missing[:4])}; give its skeleton a VRM map"
        )
    return found


def known_bones(skeleton: Skeleton) -> dict[str, int]:
    """VRM bone name to joint index, for the bones that are found by their names."""
    if skeleton.config.vrm:
        return dict(skeleton.config.vrm)
    plain = {_PREFIX.sub("", name): i for i, name in enumerate(skeleton.names)}
    return max(({bone: plain[name] for bone, name in table.items() if name in plain} for table in _TABLES), key=len)


def feet_of(bones: Mapping[str, int]) -> list[int]:
    """Joints of left foot and toes, then of the right; the foot again where there are no toes."""
    return [bones.get(f"{s}{part}", bones[f"{s}Foot"]) for s in ("left", "right") for part in ("Foot", "Toes")]


def is_upright(skeleton: Skeleton, bones: Mapping[str, int]) -> bool:
    """Whether the rest pose has the head above the hips and these above the feet (Y up)."""
    height = skeleton.rest_positions[:, 1]
    return bool(height[bones["head"]] > height[bones["hips"]] > height[bones["leftFoot"]])


def finger_bones(side: str) -> dict[str, tuple[str, str, str]]:
    """The three bones of each digit of a hand."""
    rest = ("Proximal", "Intermediate", "Distal")
    return {
        digit: tuple(  # type: ignore[misc]
            f"{side}{digit}{bone}" for bone in (("Metacarpal", "Proximal", "Distal") if digit == "Thumb" else rest)
        )
        for digit in _DIGITS
    }


class _Rig(NamedTuple):
    """The bone names of a family of rigs.

    `{s}` stands for the side, `{digit}` or `{Digit}` for a finger's name and `{n}` for its number, `{k}` for 1 to 3
    and `{j}` for nothing, 1 and 2 along it.
    """

    trunk: str  # hips, spine, chest, upper chest, neck, head; - for none
    sides: tuple[str, str]
    limbs: str  # shoulder, upper and lower arm, hand, upper and lower leg, foot, toes
    fingers: str = ""

    def table(self) -> dict[str, str]:
        """VRM bone to joint name."""
        names = zip(_TRUNK, self.trunk.split(), strict=True)
        table = {bone: name for bone, name in names if name != "-"}
        for side, s in zip(("left", "right"), self.sides, strict=True):
            table |= {side + bone: name for bone, name in zip(_LIMBS, self.limbs.format(s=s).split(), strict=True)}
            for n, (digit, bones) in enumerate(finger_bones(side).items() if self.fingers else ()):
                own = "Pinky" if digit == "Little" else digit
                for k, bone in enumerate(bones, start=1):
                    table[bone] = self.fingers.format(s=s, Digit=own, digit=own.lower(), n=n, k=k, j=k - 1 or "")
        return table


_TRUNK = ("hips", "spine", "chest", "upperChest", "neck", "head")
_LIMBS = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")
_MIXAMO = _Rig(
    "Hips Spine Spine1 Spine2 Neck Head",
    ("Left", "Right"),
    "{s}Shoulder {s}Arm {s}ForeArm {s}Hand {s}UpLeg {s}Leg {s}Foot {s}ToeBase",
    "{s}Hand{Digit}{k}",
)
_RIGS = (
    _MIXAMO,
    _MIXAMO._replace(trunk="Hips Spine Spine2 Spine3 Neck Head"),
    _MIXAMO._replace(trunk="Hips LowerBack Spine Spine1 Neck Head"),
    _Rig(  # Unreal
        "pelvis spine_01 spine_02 spine_03 neck_01 head",
        ("l", "r"),
        "clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s} thigh_{s} calf_{s} foot_{s} ball_{s}",
        "{digit}_0{k}_{s}",
    ),
    _Rig(  # 3ds Max Biped
        "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Spine2 Bip01_Neck Bip01_Head",
        ("Bip01_L", "Bip01_R"),
        "{s}_Clavicle {s}_UpperArm {s}_Forearm {s}_Hand {s}_Thigh {s}_Calf {s}_Foot {s}_Toe0",
        "{s}_Finger{n}{j}",
    ),
    _Rig(  # Bandai-Namco
        "Hips Spine - Chest Neck Head",
        ("L", "R"),
        "Shoulder_{s} UpperArm_{s} LowerArm_{s} Hand_{s} UpperLeg_{s} LowerLeg_{s} Foot_{s} Toes_{s}",
    ),
    _Rig(  # Daz
        "hip abdomen chest - neck head",
        ("l", "r"),
        "{s}Collar {s}Shldr {s}ForeArm {s}Hand {s}Thigh {s}Shin {s}Foot {s}Toe",
    ),
    _Rig(  # Rigify
        "pelvis spine spine.001 - neck face",
        ("L", "R"),
        "shoulder.{s} upper_arm.{s} forearm.{s} hand.{s} thigh.{s} shin.{s} foot.{s} toe.{s}",
    ),
)
_TABLES = ({name: name for name in HUMANOID.names}, *(rig.table() for rig in _RIGS))
