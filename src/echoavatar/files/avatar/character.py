"""The shipped character as data: a skinned mesh on the rest pose of `HUMANOID`, made by `tools/character`."""

from dataclasses import dataclass, fields
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from echoavatar.errors import CheckpointError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.motion.kinematics.tables import NPZ_ERRORS, arrays_of

from .morphs import Morphs


class Material(NamedTuple):
    """How a surface reflects light; colours are per vertex."""

    name: str
    roughness: float
    metallic: float = 0.0


MATERIALS = (
    Material("skin", 0.55),
    Material("hair", 0.45),
    Material("eye", 0.12),
    Material("cloth", 0.85),
    Material("denim", 0.90),
    Material("shoe", 0.50),
    Material("metal", 0.35, 0.6),
    Material("mouth", 0.30),
)


@dataclass(frozen=True)
class Character:
    """A skinned mesh in T-pose. `joints` index `HUMANOID.names`; triangles are counter-clockwise."""

    positions: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    colours: UInt8[np.ndarray, "v 3"]  # sRGB
    materials: UInt8[np.ndarray, " v"]  # index into MATERIALS
    joints: UInt8[np.ndarray, "v 4"]
    weights: Float[np.ndarray, "v 4"]  # rows sum to 1
    triangles: Int[np.ndarray, "f 3"]
    face: Morphs  # blendshapes of the first vertices

    @cached_property
    def dense_weights(self) -> Float[np.ndarray, "v j"]:
        """Weights as one matrix over all joints, so that skinning is one matrix product."""
        dense = np.zeros((len(self.positions), HUMANOID.joints), np.float32)
        rows = np.arange(len(dense))
        for column in range(self.joints.shape[1]):
            np.add.at(dense, (rows, self.joints[:, column]), self.weights[:, column])
        return dense

    @cached_property
    def rest_joints(self) -> Float[np.ndarray, "j 3"]:
        """World positions of the joints in the rest pose."""
        return HUMANOID.rest_positions.numpy()

    def with_face(self, weights: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
        """Positions and unit normals in the rest pose with an expression; weights are in the order of `face.names`."""
        positions, normals = self.positions.copy(), self.normals.copy()
        moves, turns = self.face.added(weights)
        positions[: len(moves)] += moves
        turned = normals[: len(turns)] + turns
        turned /= np.maximum(np.sqrt(np.einsum("vi,vi->v", turned, turned)), 1e-9)[:, None]
        normals[: len(turns)] = turned
        return positions, normals

    def save(self, path: Path) -> None:
        """Write an npz. Normals and weights are stored as integers, triangles in the smallest type that fits."""
        np.savez_compressed(
            path,
            positions=self.positions.astype(np.float32),
            normals=np.round(self.normals * 32767).astype(np.int16),
            colours=self.colours,
            materials=self.materials,
            joints=self.joints,
            weights=np.round(self.weights * 65535).astype(np.uint16),
            triangles=self.triangles.astype(np.uint16 if len(self.positions) < 65536 else np.int32),
            **self.face.arrays(),
        )


def load_character(path: Path | None = None) -> Character:
    """Read a character file, or without a path the shipped one; raises CheckpointError where it is damaged."""
    if path is None:
        with as_file(files("echoavatar") / "assets" / "character.npz") as shipped:
            return load_character(shipped)
    try:
        stored = arrays_of(path, CheckpointError)
        raw = {field.name: stored[field.name] for field in fields(Character) if field.name != "face"}
        face = Morphs.of_arrays(stored)
    except NPZ_ERRORS as error:
        raise CheckpointError(f"{path} is not a character ({error}); make it again with tools/character") from error
    normals, weights = raw["normals"].astype(np.float32), raw["weights"].astype(np.float32)
    raw["normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    raw["weights"] = weights / weights.sum(1, keepdims=True)
    raw["triangles"] = raw["triangles"].astype(np.int32)
    return Character(**raw, face=face)
