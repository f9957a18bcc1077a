"""Read the rig of a character from a GLB or VRM file, and its skinned mesh as `measure_body` needs it.

Bones are found by the humanoid map of VRM 1.0 or 0.x, or in a plain GLB by joint names (`kinematics.rigs`). The rig is
the subtree of the hips in the file's rest pose. It becomes a skeleton whose rest pose has no rotations, in metres, Y
up, rotated to face +Z. Vertices are skinned in the same pose.
"""

import json
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import DEPTH, GLB_BYTES, NODES, VERTICES, WEIGHTS, check_file

from ..kinematics import Skeleton, SkeletonConfig
from ..kinematics.rigs import REQUIRED, bone_map, feet_of
from ..kinematics.rotations import matrix_from_quaternion

Array = np.ndarray
_OLD_THUMB = {"Proximal": "Metacarpal", "Intermediate": "Proximal", "Distal": "Distal"}  # VRM 0.x to 1.0
_DAMAGE = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
    np.linalg.LinAlgError,
    struct.error,
)


class GltfRig(NamedTuple):
    """A file and what was found in it."""

    path: Path
    document: dict[str, Any]
    binary: bytes
    order: list[int]  # the node of each joint of the skeleton
    parents: dict[int, int]  # the parent of every node, -1 for the topmost
    worlds: list[Float[Array, "4 4"]]  # world matrix of every node at rest, in the file's axes
    skeleton: Skeleton
    is_turned: bool  # whether the file faces -Z, so that the skeleton was rotated by 180 degrees about Y


@contextmanager
def refusing_damage(path: Path) -> Iterator[None]:
    """Raise one error that names the file in place of whatever a damaged or hostile document causes."""
    try:
        yield
    except _DAMAGE as error:
        raise MotionError(
            f"{path} does not keep to the glTF format ({type(error).__name__}: {str(error)[:120]}); export it again"
        ) from error


def read_gltf_rig(path: Path) -> GltfRig:
    """Read a binary glTF with a skin.

    Raises:
        MotionError: the file is missing, damaged, compressed, no binary glTF, has no skin, or joints of unknown names.
    """
    with refusing_damage(path):
        return _read(path)


def _read(path: Path) -> GltfRig:
    document, binary = _chunks(path)
    used = set(document.get("extensionsRequired", []))
    if squeezed := used & {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}:
        raise MotionError(f"{path} is compressed ({squeezed.pop()}); export it without compression")
    if not document.get("skins"):
        raise MotionError(f"{path} has no skin, so nothing says which vertex follows which bone; export it rigged")
    parents = _parents(document["nodes"])
    worlds: list[Array] = [np.eye(4)] * len(parents)
    for node, parent in parents.items():
        local = _local(document["nodes"][node])
        worlds[node] = local if parent < 0 else worlds[parent] @ local
    order, bones = _rig(document, parents, path)
    slot = {node: index for index, node in enumerate(order)}
    places = np.array([worlds[node][:3, 3] for node in order])
    is_turned = bool(places[bones["leftUpperArm"], 0] < places[bones["rightUpperArm"], 0])  # as VRM 0.x does
    if is_turned:
        places = places * [-1, 1, -1]
    offsets = [
        place - (places[slot[parents[node]]] if index else 0)
        for index, (node, place) in enumerate(zip(order, places, strict=True))
    ]
    config = SkeletonConfig(
        names=_names(document["nodes"], order),
        parents=tuple(-1 if not index else slot[parents[node]] for index, node in enumerate(order)),
        offsets=tuple((float(x), float(y), float(z)) for x, y, z in offsets),
        feet=tuple(feet_of(bones)),
        vrm=bones,
    )
    return GltfRig(path, document, binary, order, parents, worlds, Skeleton(config), is_turned)


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    try:
        check_file(path, GLB_BYTES, MotionError)
        data = path.read_bytes()
    except OSError as error:
        raise MotionError(f"{path} cannot be read; check the name") from error
    try:
        magic, _, _, length, kind = struct.unpack_from("<4sIIII", data)
        if magic != b"glTF" or kind != 0x4E4F534A:
            raise ValueError
        document: dict[str, Any] = json.loads(data[20 : 20 + length])
        if not isinstance(document, dict):
            raise ValueError
    except (struct.error, ValueError, RecursionError) as error:
        raise MotionError(f"{path} is not binary glTF; export the character as .glb or .vrm") from error
    return document, data[28 + length :]


def _parents(nodes: list[dict[str, Any]]) -> dict[int, int]:
    """Each node's parent (-1 for none), parents first. Raises for missing nodes, two parents of one, and cycles."""
    if len(nodes) > NODES:
        raise ValueError(f"{len(nodes)} nodes, and at most {NODES} are read")
    parents = dict.fromkeys(range(len(nodes)), -1)
    for index, entry in enumerate(nodes):
        for child in entry.get("children", []):
            if parents[child] >= 0:
                raise ValueError(f"node {child} has two parents")
            parents[child] = index
    depths = dict.fromkeys([node for node, parent in parents.items() if parent < 0], 0)
    below = list(depths)
    for node in below:
        for child in nodes[node].get("children", []):
            depths[child] = depths[node] + 1
            below.append(child)
    if len(depths) < len(nodes):
        raise ValueError("a node is among its own parents")
    if max(depths.values()) > DEPTH:
        raise ValueError(f"nodes are more than {DEPTH} deep")
    return {node: parents[node] for node in below}


def _local(node: dict[str, Any]) -> Array:
    """A node's matrix, relative to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    rotation = matrix_from_quaternion(torch.from_numpy(np.array([w, x, y, z], np.float64))).numpy()
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1, 1, 1)))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _rig(document: dict[str, Any], parents: dict[int, int], path: Path) -> tuple[list[int], dict[str, int]]:
    """Nodes of the rig, hips first and parents before children, and the index of each bone in that list."""
    joints = {node for skin in document["skins"] for node in skin["joints"]}
    known = _humanoid(document)
    if not known:
        listed = sorted(joints)
        names = _names(document["nodes"], listed)
        flat = SkeletonConfig(
            names=names, parents=(-1, *([0] * (len(names) - 1))), offsets=((0.0, 0.0, 0.0),) * len(names)
        )
        try:
            known = {bone: listed[index] for bone, index in bone_map(Skeleton(flat)).items()}
        except MotionError as error:
            raise MotionError(f"{path}: {error}") from error
    if missing := [bone for bone in REQUIRED if bone not in known]:
        raise MotionError(f"{path} has no joint for {missing[0]}; check its humanoid map")
    order, kept = [known["hips"]], set[int]()
    for node in joints | set(known.values()):
        while node >= 0 and node not in kept:
            kept.add(node)
            node = parents[node]
    for node in order:
        order += [child for child in document["nodes"][node].get("children", []) if child in kept]
    slot = {node: index for index, node in enumerate(order)}
    if apart := [bone for bone in REQUIRED if known[bone] not in slot]:
        raise MotionError(f"{path}: its {apart[0]} does not hang from its hips; check the nodes' children")
    return order, {bone: slot[node] for bone, node in known.items() if node in slot}


def _humanoid(document: dict[str, Any]) -> dict[str, int]:
    extensions = document.get("extensions", {})
    if "VRMC_vrm" in extensions:
        bones = extensions["VRMC_vrm"]["humanoid"]["humanBones"]
        return {bone: int(entry["node"]) for bone, entry in bones.items()}
    if "VRM" in extensions:
        found: dict[str, int] = {}
        for entry in extensions["VRM"]["humanoid"]["humanBones"]:
            stem, thumb, part = entry["bone"].partition("Thumb")
            found[stem + thumb + (_OLD_THUMB[part] if thumb else part)] = int(entry["node"])
        return found
    return {}


def _names(nodes: list[dict[str, Any]], order: list[int]) -> tuple[str, ...]:
    names = [str(nodes[node].get("name", f"joint {node}")) for node in order]
    count = Counter(names)
    return tuple(f"{name} {k}" if count[name] > 1 else name for k, name in enumerate(names))


_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Skinned(NamedTuple):
    """A character in its rest pose."""

    skeleton: Skeleton
    vertices: Float[Array, "v 3"]
    weights: Float[Array, "v j"]


def read_skinned(path: Path) -> Skinned:
    """Read a binary glTF with a skin.

    Raises:
        MotionError: the file is missing, damaged, compressed, no binary glTF, has no skin, or joints of unknown names.
    """
    return skinned(read_gltf_rig(path))


def skinned(rig: GltfRig) -> Skinned:
    """The character in a file whose rig has been read.

    Raises:
        MotionError: the file has no skinned mesh, or its meshes are damaged or too large.
    """
    slot = {node: index for index, node in enumerate(rig.order)}
    with refusing_damage(rig.path), np.errstate(invalid="ignore", over="ignore"):  # looked for below
        places, weights = _skin(rig.document, rig.binary, rig.worlds, rig.parents, slot)
        vertices = (places * ([-1, 1, -1] if rig.is_turned else 1)).astype(np.float32)
        if not (np.isfinite(vertices).all() and np.isfinite(weights).all()):
            raise ValueError("vertices or weights that are not finite")
    return Skinned(rig.skeleton, vertices, weights)


def _skin(
    document: dict[str, Any], binary: bytes, worlds: list[Array], parents: dict[int, int], slot: dict[int, int]
) -> tuple[Float[Array, "v 3"], Float[Array, "v j"]]:
    """The skinned vertices of all meshes, and their weights on the rig's joints."""
    vertices, weights, total = [], [], 0
    for node in document["nodes"]:
        if "mesh" not in node or "skin" not in node:
            continue
        skin = document["skins"][node["skin"]]
        binds = np.tile(np.eye(4), (len(skin["joints"]), 1, 1))
        if "inverseBindMatrices" in skin:
            binds = _accessor(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        moves = np.array([worlds[j] for j in skin["joints"]]) @ binds
        owners = np.array([slot[_kept(j, parents, slot)] for j in skin["joints"]])
        for part in document["meshes"][node["mesh"]]["primitives"]:
            held = part["attributes"]
            if "JOINTS_0" not in held:
                continue
            count = int(document["accessors"][held["POSITION"]]["count"])
            total += count
            if total > VERTICES or total * len(slot) > WEIGHTS:
                raise ValueError(f"{total:,} vertices on {len(slot)} joints, more than are read")
            places = _accessor(document, binary, held["POSITION"])
            joints = _accessor(document, binary, held["JOINTS_0"]).astype(int)
            share = _accessor(document, binary, held["WEIGHTS_0"])
            share = share / np.maximum(share.sum(1, keepdims=True), 1e-9)
            far = np.concatenate([places, np.ones((len(places), 1))], 1)
            vertices.append(np.einsum("vk,vkij,vj->vi", share, moves[joints], far)[:, :3])
            dense = np.zeros((len(places), len(slot)), np.float32)
            np.add.at(dense, (np.arange(len(places))[:, None], owners[joints]), share)
            weights.append(dense)
    if not vertices:
        raise MotionError("no mesh of the file is skinned; export the character with its skin weights")
    return np.concatenate(vertices), np.concatenate(weights)


def _kept(joint: int, parents: dict[int, int], slot: dict[int, int]) -> int:
    """The joint itself or its nearest ancestor in the rig; the hips where there is none."""
    while joint >= 0 and joint not in slot:
        joint = parents[joint]
    return joint if joint >= 0 else next(iter(slot))


def _accessor(document: dict[str, Any], binary: bytes, index: int) -> Float[Array, "n c"]:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    if accessor["count"] < 0 or start < 0 or stride < dtype.itemsize * width:
        raise ValueError(f"accessor {index} has a count, offset or stride that cannot be")
    raw = np.ndarray((accessor["count"], width), dtype, binary, offset=start, strides=(stride, dtype.itemsize))
    scale = np.iinfo(dtype).max if accessor.get("normalized") else 1
    return raw.astype(np.float64) / scale
