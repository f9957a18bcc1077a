"""Write VRM Animation 1.0 (`.vrma`): body, face and gaze for any VRM avatar.

The skeleton in the file stands in T-pose with the character's own proportions, so that a player can scale the path of
the hips to the avatar. Only the hips are translated. As the format prescribes, an expression's weight is the X
translation of a node, and the gaze is the rotation of another node. Vowels and blinks work with every avatar; the 52
ARKit shapes work with avatars that have them.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.motion.arkit import ARKIT_NAMES, LIVE_LINK_NAMES, VRM_NAMES, to_live_link, to_vrm
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.motion import align_signs
from echoavatar.motion.kinematics.retarget import plain_rig
from echoavatar.motion.kinematics.rigs import bone_map

from ..avatar.gltf import Buffer, Tracks, joint_nodes, packed
from .rig_face import expression_weights
from .take import Take

PRESETS = VRM_NAMES[:8]  # vowels and blinks; the gaze is `lookAt`
MOODS = ("happy", "angry", "sad", "relaxed", "surprised")  # the other presets that an animation may name
_LEFT_EYE = LIVE_LINK_NAMES.index("leftEyeYaw")
_RIGHT_EYE = LIVE_LINK_NAMES.index("rightEyeYaw")
REQUIRED = ("hips", "spine", "head")


def pack_vrma(take: Take, avatar: dict[str, Any] | None = None) -> bytes:
    """The bytes of a file with a take on our rig, or on any rig whose bones are known.

    For the VRM of the document `avatar`, the face is written for the expressions that it has.

    Raises MotionError: a bone that the format requires is missing.
    """
    motion = take.motion
    if motion.skeleton is not HUMANOID:  # the format wants T-pose
        motion = plain_rig(motion.skeleton).of_own(motion)
    skeleton, bones = motion.skeleton, bone_map(motion.skeleton)
    if missing := [bone for bone in REQUIRED if bone not in bones]:
        raise MotionError(f"a VRM animation needs the bone {missing[0]}; choose a rig that has it")
    nodes = joint_nodes(skeleton)
    tracks, rotations = Tracks(Buffer(), motion.frames, motion.fps), align_signs(motion.rotations)
    for joint in range(skeleton.joints):
        tracks.add(joint, "rotation", _xyzw(rotations[:, joint].astype(np.float64)))
    tracks.add(0, "translation", motion.root)
    extension: dict[str, Any] = {
        "specVersion": "1.0",
        "humanoid": {
            "humanBones": {bone: {"node": joint} for bone, joint in sorted(bones.items()) if "Eye" not in bone}
        },
    }
    if take.face is not None:
        theirs = expression_weights(avatar, take.face) if avatar else {}
        extension |= _face(take.face, theirs, nodes, tracks)
    document = {
        "asset": {"version": "2.0", "generator": "EchoAvatar"},
        "extensionsUsed": ["VRMC_vrm_animation"],
        "scene": 0,
        "scenes": [{"nodes": [0, *range(skeleton.joints, len(nodes))]}],
        "nodes": nodes,
        "animations": [{"name": "take", "samplers": tracks.samplers, "channels": tracks.channels}],
        "extensions": {"VRMC_vrm_animation": extension},
    }
    return packed(document, tracks.buffer)


def _xyzw(wxyz: Float[np.ndarray, "t 4"]) -> Float[np.ndarray, "t 4"]:
    unit: np.ndarray = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
    return unit[:, [1, 2, 3, 0]]


def _face(
    curves: Float[np.ndarray, "t 52"], theirs: dict[str, Float[np.ndarray, " t"]], nodes: list[Any], tracks: Tracks
) -> dict[str, Any]:
    """The extension's expressions and gaze, each driven by a node that is added to `nodes`."""

    def node(name: str) -> int:
        nodes.append({"name": name})
        return len(nodes) - 1

    def express(name: str, weights: Float[np.ndarray, " t"]) -> dict[str, int]:
        at = node(name)
        tracks.add(at, "translation", np.stack([weights, 0 * weights, 0 * weights], 1))
        return {"node": at}

    ours = dict(zip(PRESETS, to_vrm(curves).T, strict=False)) | dict(zip(ARKIT_NAMES, curves.T, strict=True))
    made = {name: express(name, weights) for name, weights in (theirs or ours).items() if not name.startswith("look")}
    preset = {name: node for name, node in made.items() if name in (*PRESETS, *MOODS)}
    custom = {name: node for name, node in made.items() if name not in preset}
    look = node("lookAt")
    nodes[look]["translation"] = [0.0, 0.0, 0.0]
    tracks.add(look, "rotation", _xyzw(_gaze(curves)))
    return {
        "expressions": {"preset": preset, "custom": custom},
        "lookAt": {"node": look, "offsetFromHeadBone": [0.0, 0.06, 0.0]},
    }


def _gaze(curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 4"]:
    """The mean direction of both eyes: a rotation about Y looks left, one about X looks down."""
    columns = to_live_link(curves)
    yaw, pitch = ((columns[:, _LEFT_EYE + k] + columns[:, _RIGHT_EYE + k]) / 2 for k in (0, 1))
    (cy, sy), (cp, sp) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in (-yaw, pitch))
    return np.stack([cy * cp, cy * sp, sy * cp, -sy * sp], 1)
