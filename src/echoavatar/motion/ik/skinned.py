"""Read rig, vertices and skin weights from a GLB or VRM file, as `measure_body` needs them.

Vertices are skinned in the file's rest pose: metres, Y up, rotated to face +Z.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.limits import VERTICES, WEIGHTS

from ..formats.gltf_rig import GltfRig, read_gltf_rig, refusing_damage
from ..kinematics import Skeleton

Array = np.ndarray
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
