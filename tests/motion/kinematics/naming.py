"""Bodies whose joints have the names of a scheme."""

from typing import NamedTuple

import numpy as np
from tests.motion.kinematics.scheme import Scheme
from tests.motion.kinematics.schemes import FRAMED, SCHEMES

from echoavatar.motion.kinematics import HUMANOID, Skeleton, SkeletonConfig
from echoavatar.motion.kinematics.named_bones import finger_bones
from echoavatar.motion.kinematics.rigs import known_bones


class Named(NamedTuple):
    """A body of a scheme, and which joint each bone is."""

    skeleton: Skeleton
    bones: dict[str, str]


def body(scheme: Scheme, frame: str = "{}", *, has_noise: bool = False) -> Named:
    """A body as tall as ours with the joints of a scheme, each name put into `frame`."""
    built = _Built(scheme, frame)
    if has_noise:
        built.add_noise()
    return Named(built.skeleton(), built.bones)


def every_body() -> dict[str, tuple[Scheme, str]]:
    """All schemes and their frames, by name."""
    return {name: (scheme, "{}") for name, scheme in SCHEMES.items()} | FRAMED


class _Built:
    def __init__(self, scheme: Scheme, frame: str) -> None:
        self.frame = frame
        self.joints: dict[str, tuple[str, np.ndarray]] = {}  # parent ("" for the root) and place
        self.bones: dict[str, str] = {}
        self.chain(scheme.trunk, "", "", {})
        spine = next(self.bones[bone] for bone in ("upperChest", "chest", "spine") if bone in self.bones)
        for side, s in zip(("left", "right"), scheme.sides, strict=True):
            words = {"s": s, "S": side[0].upper(), "s0": side[0].upper()}
            self.chain(scheme.arm, side, self.name(scheme.arms_at) if scheme.arms_at else spine, words)
            self.chain(scheme.leg, side, self.name(scheme.legs_at) if scheme.legs_at else self.bones["hips"], words)
            if scheme.fingers:
                self.fingers(scheme, side, words)

    def name(self, text: str) -> str:
        return self.frame.format(text)

    def chain(self, line: str, side: str, parent: str, words: dict[str, str]) -> None:
        entries = [entry.partition("=")[::2] for entry in line.format(**words).split("/")]
        for at, (bone, text) in enumerate(entries):
            name = self.name(text)
            if name not in self.joints:
                ahead = next((_place(side + later) for later, _ in entries[at:] if later), None)
                start = self.joints[parent][1] if parent else np.zeros(3)
                middle = (
                    start + 0.4 * (ahead - start)
                    if ahead is not None and parent
                    else start + [0, 0.02 if side else 0.18, 0.0]
                )
                self.joints[name] = parent, _place(side + bone) if bone else middle
            if bone:
                self.bones[side + bone] = name
            parent = name

    def fingers(self, scheme: Scheme, side: str, words: dict[str, str]) -> None:
        for n, (bones, digit) in enumerate(zip(finger_bones(side).values(), scheme.digits.split(), strict=True)):
            more = words | {"digit": digit, "n": n, "k0": n + 1}
            line = []
            if scheme.palm and n:
                line.append("=" + scheme.palm.format(**more))
            for k, bone in enumerate(bones, start=1):
                more |= {
                    "k": k,
                    "j": k - 1 or "",
                    "letter": "abc"[k - 1],
                    "bit": bone[len(side) + len(finger_of(bone)) :],
                }
                line.append(f"{bone.removeprefix(side)}=" + scheme.fingers.format(**more))
            self.chain("/".join(line), side, self.bones[f"{side}Hand"], {})

    def add_noise(self) -> None:
        """What rigs hold besides the body: twists, ends, targets of IK, hair, cloth, things in the hand."""
        root = next(iter(self.joints))
        bones = dict(self.bones)
        for bone, name in bones.items():
            if bone.endswith(("UpperArm", "LowerArm", "UpperLeg")):
                self.put(f"{name}_twist_01", name)
                self.put(f"{name}_roll", name)
            if bone.endswith(("Hand", "Foot", "LowerArm", "head")):
                self.put(f"{name} IK", root)
                self.put(f"{name}_end", name)
        for parent, line in {
            "head": "hair_01/hair_02/hair_03 brow_L brow_R tongue/tongue_02 hat ponytail1/ponytail2 HeadTop_End",
            "hips": "skirt_front_01/skirt_front_02 skirt_L_01/skirt_L_02 tail_01/tail_02 belt",
            "spine": "breast_L breast_R cape_01/cape_02 backpack",
            "rightHand": "weapon_r Sword/Sword_end RightHandProp",
        }.items():
            for chain in line.split():
                above = bones[parent]
                for name in chain.split("/"):
                    above = self.put(name, above)
        for name in ("ik_hand_l", "ik_foot_r", "ctrl_hips", "camera"):
            self.put(name, root)

    def put(self, name: str, parent: str) -> str:
        self.joints[name] = parent, self.joints[parent][1] + [0.0, 0.004, -0.01]
        return name

    def skeleton(self) -> Skeleton:
        names = list(self.joints)
        places = np.array([place for _, place in self.joints.values()])
        parents = [names.index(parent) if parent else -1 for parent, _ in self.joints.values()]
        offsets = places - np.array([places[parent] if parent >= 0 else np.zeros(3) for parent in parents])
        return Skeleton(
            SkeletonConfig(names=tuple(names), parents=tuple(parents), offsets=tuple(map(tuple, offsets.tolist())))
        )


def finger_of(bone: str) -> str:
    return next(digit for digit in finger_bones("left") if digit in bone)


def _place(bone: str) -> np.ndarray:
    return HUMANOID.rest_positions[HUMANOID.index(bone)].astype(np.float64)


EXTRA = {"leftEye", "rightEye", "jaw"}


def names_of(skeleton: Skeleton) -> dict[str, str]:
    return {bone: skeleton.names[joint] for bone, joint in known_bones(skeleton).items() if bone not in EXTRA}


def renamed(skeleton: Skeleton, names: list[str], places: np.ndarray | None = None) -> Skeleton:
    config = skeleton.config
    rest = skeleton.rest_positions.astype(np.float64) if places is None else places
    above = [rest[parent] if parent >= 0 else np.zeros(3) for parent in config.parents]
    offsets = tuple(map(tuple, (rest - np.array(above)).tolist()))
    return Skeleton(config.model_copy(update={"names": tuple(names), "offsets": offsets, "vrm": {}}))
