"""The shipped character as data: a skinned mesh on the rest pose of `HUMANOID`, made by `tools/character`."""

from dataclasses import dataclass, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from echoavatar.errors import CheckpointError
from echoavatar.motion.formats.tables import NPZ_ERRORS, arrays_of

from .halfway import BONES, PARENTS, REST, SOURCES
from .morphs import Morphs, added
from .textures import NAMES, Textures, decoded, looked_up

CHARACTERS = ("maya", "theo", "amara")
LEVELS = 3  # of detail: NAME.lod0.glb has about 40,000 triangles, NAME.lod1.glb 15,000, NAME.lod2.glb 6,000
FOLDER = Path(str(files("echoavatar"))) / "assets" / "characters"
UV_UNITS = 8192
PLACE_UNIT = 2.0**-14  # metres; how places are stored


class Material(NamedTuple):
    """How a surface reflects light. Its colour is that of its picture times those of the vertices."""

    name: str
    roughness: float
    picture: str = ""
    is_two_sided: bool = False
    is_cutout: bool = False  # not drawn where the picture's alpha is below a half
    relief: str = ""  # a normal map
    roughness_picture: str = ""


MATERIALS = (
    Material("skin", 0.62, "atlas", roughness_picture="skin_roughness"),
    Material("eye", 0.06, "atlas"),
    Material("mouth", 0.22, "atlas"),
    Material("lash", 0.80, is_two_sided=True),
    Material("hair", 0.80, "hair", is_two_sided=True, is_cutout=True),
    Material("cloth", 0.92, "knit", is_two_sided=True, relief="knit_normal", roughness_picture="knit_roughness"),
    Material("trousers", 0.88, "twill", relief="twill_normal", roughness_picture="twill_roughness"),
    Material("shoe", 0.60),
    Material("sole", 0.70),
)


@dataclass(frozen=True)
class Character:
    """A skinned mesh in T-pose. `joints` index `BONES`; triangles are counter-clockwise."""

    positions: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    colours: UInt8[np.ndarray, "v 3"]  # sRGB; a factor on the picture
    uvs: Float[np.ndarray, "v 2"]  # v downwards; may leave 0..1 where the picture repeats
    materials: UInt8[np.ndarray, " v"]  # index into MATERIALS
    joints: UInt8[np.ndarray, "v 4"]
    weights: Float[np.ndarray, "v 4"]  # rows sum to 1
    triangles: Int[np.ndarray, "f 3"]
    face: Morphs  # blendshapes of the first vertices
    textures: Textures

    @cached_property
    def bone_weights(self) -> Float[np.ndarray, "v b"]:
        """Weights as one matrix over all `BONES`."""
        dense = np.zeros((len(self.positions), len(BONES)), np.float32)
        rows = np.arange(len(dense))
        for column in range(self.joints.shape[1]):
            np.add.at(dense, (rows, self.joints[:, column]), self.weights[:, column])
        return dense

    @cached_property
    def dense_weights(self) -> Float[np.ndarray, "v j"]:
        """Weights over the joints of `HUMANOID`: those of a halfway bone go to its bone and to its parent in halves."""
        joints = len(BONES) - len(SOURCES)
        dense, halves = self.bone_weights[:, :joints].copy(), self.bone_weights[:, joints:] / 2
        dense[:, SOURCES] += halves
        for row, parent in enumerate(PARENTS):
            dense[:, parent] += halves[:, row]
        return dense

    @cached_property
    def rest_joints(self) -> Float[np.ndarray, "b 3"]:
        """World positions of all `BONES` in the rest pose."""
        return REST

    def flat_colours(self) -> Float[np.ndarray, "v 3"]:
        """The sRGB colour of each vertex, 0 to 1, for files without pictures."""
        order = {name: row for row, name in enumerate(NAMES)}
        picture = np.array([order.get(material.picture, -1) for material in MATERIALS])[self.materials]
        return looked_up(decoded(self.textures), picture, self.uvs) * (self.colours / np.float32(255))

    def with_face(self, weights: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
        """Positions and unit normals in the rest pose with an expression; weights are in the order of `face.names`."""
        positions, normals, face = self.positions.copy(), self.normals.copy(), self.face
        strengths = np.asarray(weights, np.float32)
        added(strengths, face.starts, face.vertices, face.moves, face.turns, positions, normals, face.reach)
        return positions, normals

    def save(self, path: Path) -> None:
        """Write an npz. Normals and weights are stored as integers, triangles in the smallest type that fits."""
        np.savez_compressed(
            path,
            positions=np.round(self.positions / PLACE_UNIT).astype(np.int16),
            normals=np.round(self.normals * 127).astype(np.int8),
            colours=self.colours,
            materials=self.materials,
            joints=self.joints,
            weights=np.round(self.weights * 255).astype(np.uint8),
            triangles=self.triangles.astype(np.uint16 if len(self.positions) < 65536 else np.int32),
            uvs=np.round(self.uvs * UV_UNITS).astype(np.int32),
            **self.face.arrays(),
            **self.textures.arrays(),
        )


def load_character(path: Path | str | None = None) -> Character:
    """Read a character file, or a shipped one by its name (None: the first of `CHARACTERS`).

    Raises:
        CheckpointError: the file is damaged, or no character has this name.
    """
    if path is None or isinstance(path, str):
        path = _shipped_file(path or CHARACTERS[0], "npz")
    try:
        stored = arrays_of(path, CheckpointError)
        raw = {field.name: stored[field.name] for field in fields(Character) if field.name not in ("face", "textures")}
        face, textures = Morphs.of_arrays(stored), Textures.of_arrays(stored)
    except NPZ_ERRORS as error:
        raise CheckpointError(f"{path} is not a character ({error}); make it again with tools/character") from error
    normals, weights = raw["normals"].astype(np.float32), raw["weights"].astype(np.float32)
    raw["normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    raw["weights"] = weights / weights.sum(1, keepdims=True)
    raw["triangles"] = raw["triangles"].astype(np.int32)
    raw["positions"] = raw["positions"].astype(np.float32) * np.float32(PLACE_UNIT)
    raw["uvs"] = (raw["uvs"] / UV_UNITS).astype(np.float32)
    return Character(**raw, face=face, textures=textures)


def level_file(name: str, level: int) -> Path:
    """The GLB of a shipped character at a level of detail: meshopt compression, WebP pictures.

    Raises:
        CheckpointError: no character has this name, or there is no such level.
    """
    if not 0 <= level < LEVELS:
        raise CheckpointError(f"there is no level of detail {level}; choose from 0 (finest) to {LEVELS - 1}")
    return _shipped_file(name, f"lod{level}.glb")


def _shipped_file(name: str, suffix: str) -> Path:
    if name not in CHARACTERS:
        raise CheckpointError(f"there is no character {name!r}; choose from {', '.join(CHARACTERS)}, or give a file")
    return FOLDER / f"{name}.{suffix}"
