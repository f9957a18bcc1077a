"""Read the rig of a character from a GLB or VRM file, and its skinned mesh as `measure_body` needs it.

Bones are found by the humanoid map of VRM 1.0 or 0.x, or in a plain GLB as `kinematics.rigs` finds them. The rig is the
subtree of the hips in the file's rest pose. It becomes a skeleton whose rest pose has no rotations, in metres, Y
up, rotated to face +Z. Vertices are skinned in the same pose.
"""

from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from echoavatar.errors import MotionError
from echoavatar.limits import DEPTH, JOINTS, NODES, PRIMITIVES, SKIN_JOINTS, VERTICES

from ..kinematics import Skeleton, SkeletonConfig
from ..kinematics.rigs import REQUIRED, JointMap, Tree, check_bones, feet_of, find_bones
from ..kinematics.rotations import matrix_from_quaternion
from .gltf_data import Binary, attribute, read_accessor, read_chunks, refusing_damage

Array = np.ndarray
_OLD_THUMB = {"Proximal": "Metacarpal", "Intermediate": "Proximal", "Distal": "Distal"}  # VRM 0.x to 1.0


class GltfRig(NamedTuple):
    """A file and what was found in it."""

    path: Path
    document: dict[str, Any]
    binary: Binary
    order: list[int]  # the node of each joint of the skeleton
    parents: dict[int, int]  # the parent of every node, -1 for the topmost
    worlds: list[Float[Array, "4 4"]]  # world matrix of every node at rest, in the file's axes
    skeleton: Skeleton
    is_turned: bool  # whether the file faces -Z, so that the skeleton was rotated by 180 degrees about Y


def read_gltf_rig(path: Path, given: JointMap | None = None) -> GltfRig:
    """Read a glTF file of a character; `given` is the user's map of its bones.

    Raises:
        MotionError: the file is missing, damaged, no glTF, has no bones, or its bones are not found.
        DependencyError: the file is compressed, and what unpacks it is missing.
    """
    with refusing_damage(path):
        return _read(path, given)


def _read(path: Path, given: JointMap | None) -> GltfRig:
    document, binary = read_chunks(path)
    if not document.get("skins") and not _humanoid(document):
        raise MotionError(f"{path} has no skin, so nothing says which vertex follows which bone; export it rigged")
    parents = _parents(document["nodes"])
    worlds: list[Array] = [np.eye(4)] * len(parents)
    for node, parent in parents.items():
        local = _local(document["nodes"][node])
        worlds[node] = local if parent < 0 else worlds[parent] @ local
    order, bones, names = _rig(document, parents, worlds, path, given)
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
        names=names,
        parents=tuple(-1 if not index else slot[parents[node]] for index, node in enumerate(order)),
        offsets=tuple((float(x), float(y), float(z)) for x, y, z in offsets),
        feet=tuple(feet_of(bones)),
        vrm=bones,
    )
    return GltfRig(path, document, binary, order, parents, worlds, Skeleton(config), is_turned)


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


def _rig(
    document: dict[str, Any], parents: dict[int, int], worlds: list[Array], path: Path, given: JointMap | None
) -> tuple[list[int], dict[str, int], tuple[str, ...]]:
    """Nodes of the rig, hips first and parents before children; the index of each bone in that list; their names."""
    if (entries := sum(len(skin["joints"]) for skin in document.get("skins", []))) > SKIN_JOINTS:
        raise ValueError(f"skins of {entries:,} joints, and at most {SKIN_JOINTS:,} are read")
    mapped, kept = _humanoid(document), set[int]()
    for node in [*(joint for skin in document.get("skins", []) for joint in skin["joints"]), *mapped.values()]:
        while node >= 0 and node not in kept:
            kept.add(node)
            node = parents[node]
    if len(kept) > JOINTS:
        raise ValueError(f"{len(kept):,} joints, and at most {JOINTS:,} are read")
    nodes = [node for node in parents if node in kept]  # parents first
    place, names = {node: index for index, node in enumerate(nodes)}, _names(document["nodes"], nodes)
    tree = Tree(names, [place.get(parents[node], -1) for node in nodes], np.array([worlds[n][:3, 3] for n in nodes]))
    found = find_bones(tree, given, {bone: place[node] for bone, node in mapped.items()})
    check_bones(names, found, f"{path}: the rig")
    known = {bone: nodes[joint] for bone, joint in found.items()}
    order = [known["hips"]]
    for node in order:
        order += [child for child in document["nodes"][node].get("children", []) if child in kept]
    slot = {node: index for index, node in enumerate(order)}
    if apart := [bone for bone in REQUIRED if known[bone] not in slot]:
        raise MotionError(f"{path}: its {apart[0]} does not hang from its hips; check the nodes' children")
    bones = {bone: slot[node] for bone, node in known.items() if node in slot}
    return order, bones, tuple(names[place[node]] for node in order)


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
    names = [str(nodes[node].get("name") or f"joint {node}") for node in order]
    count = Counter(names)
    return tuple(f"{name} {k}" if count[name] > 1 else name for k, name in enumerate(names))


class Skinned(NamedTuple):
    """A character in its rest pose."""

    skeleton: Skeleton
    vertices: Float[Array, "v 3"]
    weights: csr_array  # (v, j) float32: few joints move a vertex


def read_skinned(path: Path, given: JointMap | None = None) -> Skinned:
    """Read a glTF file of a character; as `read_gltf_rig`.

    Raises:
        MotionError: as `read_gltf_rig` and `skinned`.
        DependencyError: as `read_gltf_rig`.
    """
    return skinned(read_gltf_rig(path, given))


def skinned(rig: GltfRig) -> Skinned:
    """The character in a file whose rig has been read.

    Raises:
        MotionError: the file has no skinned mesh, or its meshes are damaged or too large.
    """
    slot = {node: index for index, node in enumerate(rig.order)}
    with refusing_damage(rig.path), np.errstate(invalid="ignore", over="ignore"):  # looked for below
        places, weights = _skin(rig.document, rig.binary, rig.worlds, rig.parents, slot)
        vertices = places * np.array([-1, 1, -1] if rig.is_turned else 1, np.float32)
        if not (np.isfinite(vertices).all() and np.isfinite(weights.data).all()):
            raise ValueError("vertices or weights that are not finite")
    return Skinned(rig.skeleton, vertices, weights)


def _skin(
    document: dict[str, Any], binary: Binary, worlds: list[Array], parents: dict[int, int], slot: dict[int, int]
) -> tuple[Float[Array, "v 3"], csr_array]:
    """The skinned vertices of all meshes, and their weights (v, j) on the rig's joints.

    Where no mesh is skinned, the parts hang on the bones as they are.
    """
    owner = _owners(parents, slot)
    skins: dict[int, tuple[Array, Array]] = {}
    vertices, owners, shares = [], [], []
    for node, skin, part in _drawn(document):
        places = attribute(document, binary, part, "POSITION")
        if skin is None:
            joints, share = np.zeros((len(places), 4), int), np.tile([1.0, 0, 0, 0], (len(places), 1))
            moves, known = worlds[node][None], np.array([owner[node]], np.int32)
        else:
            if skin not in skins:
                bones = document["skins"][skin]["joints"]
                moves = np.array([worlds[joint] for joint in bones]) @ _binds(document, binary, skin)
                skins[skin] = moves, np.array([owner[joint] for joint in bones], np.int32)
            moves, known = skins[skin]
            joints = attribute(document, binary, part, "JOINTS_0").astype(int)
            share = attribute(document, binary, part, "WEIGHTS_0")
        if share.shape[1] != 4:
            raise ValueError(f"{share.shape[1]} weights for a vertex, where the format has 4")
        share = share / np.maximum(share.sum(1, keepdims=True), 1e-9)
        vertices.append(_moved(places, share, joints, moves).astype(np.float32))
        owners.append(known[joints])
        shares.append(share.astype(np.float32))
    if not vertices:
        raise MotionError("no mesh of the file is skinned; export the character with its skin weights")
    share = np.concatenate(shares)
    starts = np.arange(0, share.size + 1, 4)
    weights = csr_array((share.ravel(), np.concatenate(owners).ravel(), starts), (len(share), len(slot)))
    weights.sum_duplicates()
    return np.concatenate(vertices), weights


def _drawn(document: dict[str, Any]) -> list[tuple[int, int | None, dict[str, Any]]]:
    """The node, the skin and each primitive of all skinned meshes, or of all meshes where none is skinned.

    Raises for more primitives or vertices than a body has.
    """
    drawn = [(index, node) for index, node in enumerate(document["nodes"]) if "mesh" in node]
    skinned = [(index, node) for index, node in drawn if "skin" in node]
    found, primitives, vertices = [], 0, 0
    for index, node in skinned or ([] if document.get("skins") else drawn):
        parts = document["meshes"][node["mesh"]]["primitives"]
        primitives += len(parts)
        if primitives > PRIMITIVES:
            raise ValueError(f"meshes of {primitives:,} primitives, and at most {PRIMITIVES:,} are read")
        for part in parts:
            if "JOINTS_0" in part["attributes"] or not skinned:
                vertices += document["accessors"][part["attributes"]["POSITION"]]["count"]
                found.append((index, node.get("skin"), part))
            if vertices > VERTICES:
                raise ValueError(f"meshes of {vertices:,} vertices, and at most {VERTICES:,} are read")
    return found


def _binds(document: dict[str, Any], binary: Binary, skin: int) -> Float[Array, "j 4 4"]:
    """The inverse bind matrix of each joint of a skin."""
    entry = document["skins"][skin]
    count = len(entry["joints"])
    if "inverseBindMatrices" not in entry:
        return np.tile(np.eye(4), (count, 1, 1))
    return read_accessor(document, binary, entry["inverseBindMatrices"], count).reshape(-1, 4, 4).transpose(0, 2, 1)


BLOCK = 1 << 14  # vertices that are moved at once: a matrix for each influence takes half a kilobyte a vertex


def _moved(
    places: Float[Array, "v 3"], share: Float[Array, "v k"], joints: Int[Array, "v k"], moves: Float[Array, "j 4 4"]
) -> Float[Array, "v 3"]:
    """The vertices where their joints put them."""
    far = np.concatenate([places, np.ones((len(places), 1))], 1)
    blocks = [slice(start, start + BLOCK) for start in range(0, len(far), BLOCK)]
    moved = [np.einsum("vk,vkij,vj->vi", share[here], moves[joints[here]], far[here])[:, :3] for here in blocks]
    return np.concatenate(moved) if moved else far[:, :3]


def _owners(parents: dict[int, int], slot: dict[int, int]) -> dict[int, int]:
    """The rig's joint of each node: its own, or that of its nearest ancestor in the rig; the hips where none is."""
    owner = {-1: 0}
    for node, parent in parents.items():  # parents first
        owner[node] = slot.get(node, owner[parent])
    return owner
