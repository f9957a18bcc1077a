"""Read a binary glTF: its document, the tree of its nodes with their matrices, and its accessors."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.errors import MotionError
from echoavatar.json_reader import read_object
from echoavatar.limits import DEPTH, GLB_BYTES, GLTF_BYTES, NODES, check_file

from ..kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix

Array = np.ndarray
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
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@contextmanager
def refusing_damage(path: Path) -> Iterator[None]:
    """Raise one error that names the file in place of whatever a damaged or hostile document causes."""
    try:
        yield
    except _DAMAGE as error:
        raise MotionError(
            f"{path} does not keep to the glTF format ({type(error).__name__}: {str(error)[:120]}); export it again"
        ) from error


def read_chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """The document and the binary part of a file. Raises MotionError where it is no binary glTF."""
    try:
        check_file(path, GLB_BYTES, MotionError)
        with path.open("rb", buffering=0) as file:  # a buffer would copy what is read
            head = file.read(20)
            magic, _, _, length, kind = struct.unpack("<4sIIII", head)
            if magic != b"glTF" or kind != 0x4E4F534A:
                raise MotionError(f"{path} is not binary glTF; export the character as .glb or .vrm")
            document = read_object(
                file.read(min(length, GLTF_BYTES + 1)), f"the JSON in {path}", most=GLTF_BYTES, error=MotionError
            )
            file.seek(28 + length)
            return document, file.read()
    except struct.error as error:
        raise MotionError(f"{path} is not binary glTF; export the character as .glb or .vrm") from error
    except OSError as error:
        raise MotionError(f"{path} cannot be read; check the name") from error


def parents_of(nodes: list[dict[str, Any]]) -> dict[int, int]:
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


def above(parents: dict[int, int], node: int) -> list[int]:
    """The nodes that a node hangs from, the nearest first."""
    found = []
    while (node := parents[node]) >= 0:
        found.append(node)
    return found


def node_matrix(node: dict[str, Any]) -> Float[Array, "4 4"]:
    """A node's matrix, relative to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    rotation = matrix_from_quaternion(torch.from_numpy(np.array([w, x, y, z], np.float64))).numpy()
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1, 1, 1)))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def scale_of(node: dict[str, Any]) -> Float[Array, "3"]:
    """A node's scale; a matrix that mirrors does so along X."""
    if "matrix" not in node:
        return np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix = node_matrix(node)[:3, :3]
    scale: Array = np.linalg.norm(matrix, axis=0) * [np.sign(np.linalg.det(matrix)), 1, 1]
    return scale


def rotation_of(node: dict[str, Any]) -> Float[Array, "4"]:
    """A node's rotation (xyzw)."""
    turn = unscaled(node_matrix(node)) * np.sign(scale_of(node))
    rotation: Array = quaternion_from_matrix(torch.from_numpy(turn)).numpy()[[1, 2, 3, 0]]
    return rotation


def worlds_of(locals_: dict[int, Array], parents: dict[int, int]) -> Float[Array, "n *t 4 4"]:
    """World matrices of nodes; `parents` lists parents first."""
    worlds = np.empty((len(parents), *locals_[0].shape))
    for node, parent in parents.items():
        worlds[node] = locals_[node] if parent < 0 else worlds[parent] @ locals_[node]
    return worlds


def unscaled(matrix: Float[Array, "*n 4 4"]) -> Float[Array, "*n 3 3"]:
    """The axes of a node, at right angles and of length 1; mirrored where its matrix mirrors."""
    u, _, v = np.linalg.svd(matrix[..., :3, :3])
    axes: Array = u @ v
    return axes


def binds_of(document: dict[str, Any], binary: bytes, skin: int) -> Float[Array, "j 4 4"]:
    """The inverse bind matrix of each joint of a skin."""
    entry = document["skins"][skin]
    count = len(entry["joints"])
    if "inverseBindMatrices" not in entry:
        return np.tile(np.eye(4), (count, 1, 1))
    return read_accessor(document, binary, entry["inverseBindMatrices"], count).reshape(-1, 4, 4).transpose(0, 2, 1)


def read_accessor(document: dict[str, Any], binary: bytes, index: int, count: int) -> Float[Array, "n c"]:
    """The first `count` elements of an accessor, which must have as many."""
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    if not 0 <= count <= accessor["count"] or start < 0 or stride < dtype.itemsize * width:
        raise ValueError(f"accessor {index} has a count, offset or stride that cannot be")
    raw = np.ndarray((count, width), dtype, binary, offset=start, strides=(stride, dtype.itemsize))
    scale = np.iinfo(dtype).max if accessor.get("normalized") else 1
    with np.errstate(invalid="ignore"):  # what is no number is looked for by those who need one
        return raw.astype(np.float64) / scale
