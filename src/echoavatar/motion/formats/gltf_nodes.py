"""The nodes of a glTF file: their tree, their matrices, and the binds of its skins."""

from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.limits import DEPTH, NODES

from ..kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from .gltf_data import Gltf

Array = np.ndarray


def parents_of(nodes: list[dict[str, Any]]) -> dict[int, int]:
    """Each node's parent (-1 for none), parents first. Raises ValueError or LookupError: the nodes are no forest."""
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
    """The ancestors of a node, the nearest first."""
    found = []
    while (node := parents[node]) >= 0:
        found.append(node)
    return found


def node_matrix(node: dict[str, Any]) -> Float[Array, "4 4"]:
    """A node's matrix, relative to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    rotation = matrix_from_quaternion(np.array([w, x, y, z], np.float64))
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
    return quaternion_from_matrix(turn)[[1, 2, 3, 0]]


def worlds_of(locals_: dict[int, Array], parents: dict[int, int]) -> Float[Array, "n *t 4 4"]:
    """World matrices from local ones; `parents` lists parents first."""
    worlds = np.empty((len(parents), *locals_[0].shape))
    for node, parent in parents.items():
        worlds[node] = locals_[node] if parent < 0 else worlds[parent] @ locals_[node]
    return worlds


def unscaled(matrix: Float[Array, "*n 4 4"]) -> Float[Array, "*n 3 3"]:
    """The axes of a node, at right angles and of length 1; mirrored where its matrix mirrors."""
    axes: Array = matrix[..., :3, :3]
    with np.errstate(all="ignore"):  # a length of 0
        axes = axes / np.linalg.norm(axes[..., :1], axis=-2, keepdims=True)
        is_skew = ~(np.abs(axes.swapaxes(-1, -2) @ axes - np.eye(3)) < 1e-6).all((-2, -1))
    u, _, v = np.linalg.svd(matrix[is_skew, :3, :3])
    axes[is_skew] = u @ v
    return axes


def binds_of(file: Gltf, skin: int) -> Float[Array, "j 4 4"]:
    """The inverse bind matrix of each joint of a skin."""
    entry = file.document["skins"][skin]
    count = len(entry["joints"])
    if "inverseBindMatrices" not in entry:
        return np.tile(np.eye(4), (count, 1, 1))
    return file.accessor(entry["inverseBindMatrices"], count).reshape(-1, 4, 4).transpose(0, 2, 1)
