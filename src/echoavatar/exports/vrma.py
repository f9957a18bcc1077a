"""VRM Animation 1.0 (`.vrma`): body, face and gaze for any VRM avatar.

The skeleton in the file stands in T-pose with the character's own proportions, so that a player can scale the hips'
path to the avatar; only the hips travel. Expression weights are the X of a node's translation and the gaze is the
rotation of another node, as the format has it. Vowels and blinks serve every avatar, the 52 ARKit shapes those that
have them.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..avatar.gltf import container, continuous, write_whole
from ..avatar.gltf_buffer import Buffer
from ..errors import MotionError
from ..face.arkit import ARKIT_NAMES, LIVE_LINK_NAMES, VRM_NAMES, to_live_link, to_vrm
from ..kinematics import HUMANOID, Motion, Skeleton
from ..kinematics.retarget import retarget
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import quaternion_from_matrix
from .take import Take

PRESETS = VRM_NAMES[:8]  # vowels and blinks; looks go by `lookAt`
_LEFT_EYE = LIVE_LINK_NAMES.index("leftEyeYaw")
_RIGHT_EYE = LIVE_LINK_NAMES.index("rightEyeYaw")
REQUIRED = ("hips", "spine", "head")


def write_vrma(path: Path, take: Take) -> None:
    """Write a take on our rig, or on any whose bones are known.

    Raises:
        MotionError: bones that the format wants are missing, or the file cannot be written.
    """
    write_whole(path, pack_vrma(take))


def pack_vrma(take: Take) -> bytes:
    """The file's bytes."""
    motion = take.motion if take.motion.skeleton is HUMANOID else in_t_pose(take.motion)
    skeleton, bones = motion.skeleton, bone_map(motion.skeleton)
    if missing := [bone for bone in REQUIRED if bone not in bones]:
        raise MotionError(f"a VRM animation needs the bone {missing[0]}; choose a rig that has it")
    nodes = [
        {"name": name, "translation": [float(x) for x in offset]}
        for name, offset in zip(skeleton.names, skeleton.config.offsets, strict=True)
    ]
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(joint)  # type: ignore[attr-defined]
    tracks = _Tracks(motion)
    for joint in range(skeleton.joints):
        tracks.rotate(joint, tracks.turns[:, joint])
    tracks.move(0, motion.root)
    extension: dict[str, Any] = {
        "specVersion": "1.0",
        "humanoid": {"humanBones": {bone: {"node": joint} for bone, joint in sorted(bones.items())}},
    }
    if take.face is not None:
        extension |= _face(take.face, nodes, tracks, bones)
    document = {
        "asset": {"version": "2.0", "generator": "EchoAvatar"},
        "extensionsUsed": ["VRMC_vrm_animation"],
        "scene": 0,
        "scenes": [{"nodes": [0, *range(skeleton.joints, len(nodes))]}],
        "nodes": nodes,
        "animations": [{"name": "take", "samplers": tracks.samplers, "channels": tracks.channels}],
        "extensions": {"VRMC_vrm_animation": extension},
        "accessors": tracks.buffer.accessors,
        "bufferViews": tracks.buffer.views,
        "buffers": [{"byteLength": len(tracks.buffer.data)}],
    }
    return container(document, bytes(tracks.buffer.data))


def in_t_pose(motion: Motion) -> Motion:
    """The same motion of a skeleton whose rest pose is the T-pose of the same body: the format allows no other."""
    skeleton = motion.skeleton
    still = np.zeros((1, HUMANOID.joints, 4), np.float32)
    still[..., 0] = 1
    ours = Motion(HUMANOID, still, HUMANOID.offsets[:1].numpy(), motion.fps)
    stands = retarget(ours, skeleton, has_footing=False).pose()
    places, turns = stands.positions[0].numpy(), stands.rotations[0].double()
    parents = np.array(skeleton.parents)
    offsets = places - np.where(parents[:, None] < 0, 0, places[parents])
    rest = skeleton.config.model_copy(update={"offsets": tuple(map(tuple, offsets.tolist())), "tips": {}})
    world = motion.pose().rotations.double() @ turns.transpose(-1, -2)
    local = world.clone()
    local[:, 1:] = world[:, parents[1:]].transpose(-1, -2) @ world[:, 1:]
    rotations = quaternion_from_matrix(local).numpy().astype(np.float32)
    return Motion(Skeleton(rest), rotations, motion.root, motion.fps)


class _Tracks:
    """Samplers and channels on one clock."""

    def __init__(self, motion: Motion) -> None:
        self.buffer = Buffer()
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self.turns = continuous(motion.rotations.astype(np.float64))
        times = (np.arange(motion.frames) / motion.fps).astype(np.float32)
        self._clock = self.buffer.add(times, bounds=True)

    def rotate(self, node: int, wxyz: Float[np.ndarray, "t 4"]) -> None:
        """Turn a node."""
        unit = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
        self._add(node, "rotation", unit[:, [1, 2, 3, 0]])

    def move(self, node: int, places: Float[np.ndarray, "t 3"]) -> None:
        """Move a node."""
        self._add(node, "translation", places)

    def _add(self, node: int, path: str, values: np.ndarray) -> None:
        self.channels.append({"sampler": len(self.samplers), "target": {"node": node, "path": path}})
        output = self.buffer.add(values.astype(np.float32))
        self.samplers.append({"input": self._clock, "interpolation": "LINEAR", "output": output})


def _face(
    curves: Float[np.ndarray, "t 52"], nodes: list[Any], tracks: _Tracks, bones: dict[str, int]
) -> dict[str, Any]:
    """Expressions and gaze as nodes of their own."""

    def node(name: str) -> int:
        nodes.append({"name": name})
        return len(nodes) - 1

    def express(name: str, weights: Float[np.ndarray, " t"]) -> dict[str, int]:
        at = node(name)
        tracks.move(at, np.stack([weights, 0 * weights, 0 * weights], 1))
        return {"node": at}

    preset = {name: express(name, weights) for name, weights in zip(PRESETS, to_vrm(curves).T, strict=False)}
    custom = {name: express(name, weights) for name, weights in zip(ARKIT_NAMES, curves.T, strict=True)}
    look = node("lookAt")
    nodes[look]["translation"] = [0.0, 0.0, 0.0]
    tracks.rotate(look, _gaze(curves))
    return {
        "expressions": {"preset": preset, "custom": custom},
        "lookAt": {"node": look, "offsetFromHeadBone": [0.0, 0.06, 0.0]},
    }


def _gaze(curves: Float[np.ndarray, "t 52"]) -> Float[np.ndarray, "t 4"]:
    """Where both eyes look in the mean: left by a turn about Y, down by one about X."""
    columns = to_live_link(curves)
    yaw, pitch = ((columns[:, _LEFT_EYE + k] + columns[:, _RIGHT_EYE + k]) / 2 for k in (0, 1))
    (cy, sy), (cp, sp) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in (-yaw, pitch))
    return np.stack([cy * cp, cy * sp, sy * cp, -sy * sp], 1)
