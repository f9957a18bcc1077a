"""A person as a file: what `echoavatar.files.avatar.load_character` reads is written here, in its units."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from echoavatar.files.avatar import Character
from echoavatar.files.avatar.character import MOVE_UNIT, PLACE_UNIT, TURN_UNIT, UV_UNITS, Morphs, picture_names
from echoavatar.files.avatar.halfway import BONES

LEAST_MOVE, LEAST_TURN = 1.5e-4, 0.06  # metres, and parts of a unit normal; smaller changes of a shape are left out


def save(character: Character, path: Path) -> None:
    """Write an npz. Normals and weights are stored as integers, triangles in the smallest type that fits."""
    face = character.face
    pictures: dict[str, Any] = {
        f"texture_{name}": np.frombuffer(character.textures[name], np.uint8)
        for name in picture_names(len(character.outfits))
    }
    np.savez_compressed(
        path,
        positions=np.round(character.positions / PLACE_UNIT).astype(np.int16),
        normals=np.round(character.normals * 127).astype(np.int8),
        colours=character.colours,
        materials=character.materials,
        joints=character.joints,
        weights=np.round(character.weights * 255).astype(np.uint8),
        triangles=character.triangles.astype(np.uint16 if len(character.positions) < 65536 else np.int32),
        uvs=np.round(character.uvs * UV_UNITS).astype(np.int32),
        outfits=np.array(character.outfits),
        face_names=np.array(face.names),
        face_starts=face.starts.astype(np.int32),
        face_vertices=face.vertices.astype(np.uint16),
        face_moves=np.round(face.moves / MOVE_UNIT).astype(np.int16),
        face_turns=np.clip(np.round(face.turns / TURN_UNIT), -127, 127).astype(np.int8),
        **pictures,
    )


def sparse(names: Sequence[str], moves: Float[np.ndarray, "n v 3"], turns: Float[np.ndarray, "n v 3"]) -> Morphs:
    """Sparse shapes from the moves (metres) and the turns of normals of all vertices; tiny changes are left out."""
    entries = [
        np.flatnonzero((np.abs(move).max(1) > LEAST_MOVE) | (np.abs(turn).max(1) > LEAST_TURN))
        for move, turn in zip(moves, turns, strict=True)
    ]
    return Morphs(
        tuple(names),
        np.cumsum([0, *(len(e) for e in entries)]),
        np.concatenate(entries),
        np.concatenate([move[e] for move, e in zip(moves, entries, strict=True)]).astype(np.float32),
        np.concatenate([turn[e] for turn, e in zip(turns, entries, strict=True)]).astype(np.float32),
    )


def bone_weights(character: Character) -> Float[np.ndarray, "v b"]:
    """Skin weights as one matrix over all `BONES`."""
    dense = np.zeros((len(character.positions), len(BONES)), np.float32)
    rows = np.arange(len(dense))
    for column in range(character.joints.shape[1]):
        np.add.at(dense, (rows, character.joints[:, column]), character.weights[:, column])
    return dense
