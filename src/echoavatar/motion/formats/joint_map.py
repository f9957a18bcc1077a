"""The user's own map from bones to joints: a JSON object such as `{"hips": "Bone.001", "leftToes": null}`.

It comes before what is read from names and shape. `null` says that the rig does not have the bone; bones that the map
leaves out are looked for.
"""

from collections.abc import Mapping
from pathlib import Path

from echoavatar.errors import MotionError
from echoavatar.json_reader import read_object_file
from echoavatar.limits import readable

from ..kinematics.rigs import BONES, UnknownRigError, known_bones
from .bvh import read_bvh
from .gltf_rig import read_gltf_rig
from .kinds import BVH, kind_of


def read_map(path: Path | None) -> dict[str, str | None] | None:
    """The map in a file; None for no file.

    Raises MotionError: the file is missing, no JSON object, or names an unknown bone, or one joint twice.
    """
    if path is None:
        return None
    with readable(path, MotionError):
        given = read_object_file(path, error=MotionError)
    joints: dict[str, str] = {}
    for bone, joint in given.items():
        if bone not in BONES:
            raise MotionError(
                f"{path}: {bone[:60]!r} is no bone; they are {', '.join(BONES[:4])}, ... as --template lists"
            )
        if joint is None:
            continue
        if not isinstance(joint, str):
            raise MotionError(f"{path}: {bone} is {str(joint)[:60]}; write the name of a joint, or null for none")
        if joint in joints:
            raise MotionError(f"{path}: {joint[:60]!r} is both {joints[joint]} and {bone}; keep one")
        joints[joint] = bone
    return given


def map_of(path: Path) -> dict[str, str | None]:
    """The map of a character or clip (.glb, .vrm, .bvh), with None for the bones that were not found.

    Raises MotionError: the file cannot be read.
    """
    found: Mapping[str, str]
    try:
        rig = read_bvh(path).skeleton if kind_of(path) == BVH else read_gltf_rig(path).skeleton
        found = {bone: rig.names[joint] for bone, joint in known_bones(rig).items()}
    except UnknownRigError as error:
        found = error.found
    return {bone: found.get(bone) for bone in BONES}
