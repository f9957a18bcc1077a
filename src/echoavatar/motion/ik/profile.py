"""The thickness of a character: ellipsoids on the bones of spine and head, and half the thickness of a hand.

The paper sets the radii around the spine by hand for one model. Here they are data: measured on a mesh
(`measure_body`), scaled from bone lengths (`body_of_rig`), or read from a JSON file that can be edited by hand.
"""

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import MotionError

from ..kinematics import HUMANOID, Skeleton
from ..kinematics.rigs import bone_map

COLUMN = ("hips", "spine", "chest", "upperChest", "neck", "head")
Vector = tuple[float, float, float]


class RoundedPart(Config):
    """An ellipsoid that moves with a bone; its axes are those of the bone (rest: x left, y up, z ahead)."""

    bone: Literal["hips", "spine", "chest", "upperChest", "neck", "head"] = Field(
        description="VRM bone that carries it"
    )
    centre: Vector = Field(description="from the bone's joint, in its frame, metres")
    radii: Vector = Field(description="half axes: half width, half height, half depth, metres")


class BodyProfile(Config):
    """The body that hands must not enter, and the hands' own thickness. Metres."""

    parts: tuple[RoundedPart, ...] = Field(min_length=1, description="torso, neck and head, from below")
    palm: float = Field(0.020, ge=0, description="half the thickness of wrist and palm")
    finger: float = Field(0.010, ge=0, description="half the thickness of a finger")

    def save(self, path: Path) -> None:
        """Write the profile as JSON."""
        path.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> "BodyProfile":
        """Read a file of `save`. Raises MotionError if it is missing or not a profile."""
        try:
            return cls.model_validate_json(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise MotionError(f"the body profile {path} cannot be read; check the name") from error
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            raise MotionError(
                f"{path} is not a body profile: {where}: {first['msg']}; measure the character anew"
            ) from error


def body_of_rig(skeleton: Skeleton) -> BodyProfile:
    """A profile for a rig without a mesh: our character's, scaled to the rig's trunk, neck and shoulder breadth.

    Raises MotionError when the rig's bones are not known.
    """
    bones, ours = bone_map(skeleton), bone_map(HUMANOID)
    broad = _breadth(skeleton, bones) / _breadth(HUMANOID, ours)
    tall = _trunk(skeleton, bones) / _trunk(HUMANOID, ours)
    thick = min(broad, 1.25 * tall)
    hand = _forearm(skeleton, bones) / _forearm(HUMANOID, ours)
    parts = []
    for part in _OURS.parts:
        if part.bone not in bones:
            continue
        middle = HUMANOID.rest_positions[ours[part.bone], 1].item() + part.centre[1]
        hips = HUMANOID.rest_positions[ours["hips"], 1].item()
        height = skeleton.rest_positions[bones["hips"], 1].item() + tall * (middle - hips)
        up = height - skeleton.rest_positions[bones[part.bone], 1].item()
        x, y, z = part.radii
        parts.append(
            RoundedPart(
                bone=part.bone,
                centre=(part.centre[0], up, part.centre[2] * thick),
                radii=(x * thick, y * tall, z * thick),
            )
        )
    return BodyProfile(parts=tuple(parts), palm=_OURS.palm * hand, finger=_OURS.finger * hand)


def _breadth(skeleton: Skeleton, bones: dict[str, int]) -> float:
    rest = skeleton.rest_positions
    return float((rest[bones["leftUpperArm"]] - rest[bones["rightUpperArm"]]).norm())


def _trunk(skeleton: Skeleton, bones: dict[str, int]) -> float:
    rest = skeleton.rest_positions
    return float((rest[bones["head"]] - rest[bones["hips"]]).norm())


def _forearm(skeleton: Skeleton, bones: dict[str, int]) -> float:
    rest = skeleton.rest_positions
    return float((rest[bones["leftHand"]] - rest[bones["leftLowerArm"]]).norm())


def _ours() -> BodyProfile:
    """The profile of the first shipped character without her hair, as `measure_body` gives it."""
    rows: tuple[tuple[str, Vector, Vector], ...] = (
        ("hips", (0.0, 0.0133, 0.007), (0.1955, 0.1349, 0.1408)),
        ("spine", (0.0, 0.0576, 0.027), (0.1975, 0.1262, 0.1395)),
        ("chest", (0.0, 0.0625, 0.0327), (0.2487, 0.1374, 0.143)),
        ("upperChest", (0.0, 0.0825, 0.0128), (0.2717, 0.1402, 0.1368)),
        ("neck", (0.0, 0.0405, 0.0058), (0.0402, 0.0594, 0.0419)),
        ("head", (0.0, 0.0499, 0.0295), (0.0949, 0.1367, 0.1126)),
    )
    parts = [{"bone": bone, "centre": centre, "radii": radii} for bone, centre, radii in rows]
    return BodyProfile.model_validate({"parts": parts, "palm": 0.019, "finger": 0.0117})


_OURS = _ours()
