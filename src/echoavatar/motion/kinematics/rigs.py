"""Map a rig's joints to the bones of the VRM humanoid set by their names.

Known are the names of VRM, Mixamo (also High Fidelity and ZeroEGGS), Unreal (Mesh2Motion), 3ds Max Biped (Rocketbox),
Bandai-Namco, Daz and Rigify (FreeMoCap, whose wrist is the tip of the lower arm). Each further rig is one more table.
"""

import re

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
    """VRM bone name to joint index, for those bones that the rig's names tell."""
    if skeleton.config.vrm:
        return dict(skeleton.config.vrm)
    plain = {_PREFIX.sub("", name): i for i, name in enumerate(skeleton.names)}
    return max(({bone: plain[name] for bone, name in table.items() if name in plain} for table in _tables()), key=len)


def finger_bones(side: str) -> dict[str, tuple[str, str, str]]:
    """The three bones of each digit of a hand."""
    rest = ("Proximal", "Intermediate", "Distal")
    return {
        digit: tuple(  # type: ignore[misc]
            f"{side}{digit}{bone}" for bone in (("Metacarpal", "Proximal", "Distal") if digit == "Thumb" else rest)
        )
        for digit in _DIGITS
    }


def _tables() -> list[dict[str, str]]:
    return [
        {name: name for name in HUMANOID.names},
        _mixamo(("Spine", "Spine1", "Spine2")),
        _mixamo(("Spine", "Spine2", "Spine3")),
        _mixamo(("LowerBack", "Spine", "Spine1")),
        _unreal(),
        _biped(),
        _bandai(),
        _daz(),
        _rigify(),
    ]


def _mixamo(spine: tuple[str, str, str]) -> dict[str, str]:
    table = {"hips": "Hips", "neck": "Neck", "head": "Head"}
    table |= dict(zip(("spine", "chest", "upperChest"), spine, strict=True))
    for side, own in (("left", "Left"), ("right", "Right")):
        table |= _limbs(
            side, f"{own}Shoulder {own}Arm {own}ForeArm {own}Hand {own}UpLeg {own}Leg {own}Foot {own}ToeBase"
        )
        for digit, bones in finger_bones(side).items():
            named = "Pinky" if digit == "Little" else digit
            table |= {bone: f"{own}Hand{named}{k}" for k, bone in enumerate(bones, start=1)}
    return table


def _unreal() -> dict[str, str]:
    table = {"hips": "pelvis", "spine": "spine_01", "chest": "spine_02", "upperChest": "spine_03"}
    table |= {"neck": "neck_01", "head": "head"}
    for side, s in (("left", "l"), ("right", "r")):
        table |= _limbs(side, f"clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s} thigh_{s} calf_{s} foot_{s} ball_{s}")
        for digit, bones in finger_bones(side).items():
            named = "pinky" if digit == "Little" else digit.lower()
            table |= {bone: f"{named}_0{k}_{s}" for k, bone in enumerate(bones, start=1)}
    return table


def _biped() -> dict[str, str]:
    table = {"hips": "Pelvis", "spine": "Spine", "chest": "Spine1", "upperChest": "Spine2"}
    table |= {"neck": "Neck", "head": "Head"}
    for side, s in (("left", "L"), ("right", "R")):
        table |= _limbs(side, f"{s}_Clavicle {s}_UpperArm {s}_Forearm {s}_Hand {s}_Thigh {s}_Calf {s}_Foot {s}_Toe0")
        for number, bones in enumerate(finger_bones(side).values()):
            table |= {bone: f"{s}_Finger{number}{k or ''}" for k, bone in enumerate(bones)}
    return {bone: f"Bip01_{name}" for bone, name in table.items()}


def _bandai() -> dict[str, str]:
    table = {"hips": "Hips", "spine": "Spine", "upperChest": "Chest", "neck": "Neck", "head": "Head"}
    for side, s in (("left", "L"), ("right", "R")):
        table |= _limbs(
            side, f"Shoulder_{s} UpperArm_{s} LowerArm_{s} Hand_{s} UpperLeg_{s} LowerLeg_{s} Foot_{s} Toes_{s}"
        )
    return table


def _daz() -> dict[str, str]:
    table = {"hips": "hip", "spine": "abdomen", "chest": "chest", "neck": "neck", "head": "head"}
    for side, s in (("left", "l"), ("right", "r")):
        table |= _limbs(side, f"{s}Collar {s}Shldr {s}ForeArm {s}Hand {s}Thigh {s}Shin {s}Foot {s}Toe")
    return table


def _rigify() -> dict[str, str]:
    table = {"hips": "pelvis", "spine": "spine", "chest": "spine.001", "neck": "neck", "head": "face"}
    for side, s in (("left", "L"), ("right", "R")):
        table |= _limbs(side, f"shoulder.{s} upper_arm.{s} forearm.{s} hand.{s} thigh.{s} shin.{s} foot.{s} toe.{s}")
    return table


def _limbs(side: str, names: str) -> dict[str, str]:
    bones = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")
    return {f"{side}{bone}": name for bone, name in zip(bones, names.split(), strict=True)}
