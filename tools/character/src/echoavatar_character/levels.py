"""Levels of detail: `python -m echoavatar_character.levels [NAME ...]` writes NAME.lod0.glb to NAME.lod2.glb.

They are made from the shipped NAME.npz. meshoptimizer and gltf-transform do the work (`npm ci` in tools/character).
A level keeps some of the vertices and moves none, so that pictures, weights and face curves stay as they are; of hair
it keeps some of the ribbons, made wider. Which vertices it can lose is judged with lowered arms: a flat shoulder of the
T-pose is a round one then.
"""

import argparse
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from echoavatar.files.avatar import CHARACTERS, MATERIALS, Character, load_character
from echoavatar.files.avatar.character import DETAILS, FOLDER, Morphs
from echoavatar.files.avatar.gltf import pack_glb
from echoavatar.files.avatar.halfway import REST

from .pose import DOWN, posed
from .stored import bone_weights

TOOLS = Path(__file__).parents[2]
TRIANGLES: tuple[Mapping[str, int], ...] = (  # by material; what is not named is kept
    {"skin": 19_000, "cloth": 5_800, "trousers": 2_500, "shoe": 1_500, "sole": 400, "eye": 1_250, "mouth": 1_900},
    {"skin": 6_600, "cloth": 2_300, "trousers": 900, "shoe": 500, "sole": 180, "eye": 480, "mouth": 800},
    {"skin": 2_850, "cloth": 1_200, "trousers": 380, "shoe": 220, "sole": 100, "eye": 240, "mouth": 340},
)
PICTURES = ((2048, 82, 1024), (1024, 80, 1024), (1024, 72, 512))  # widest picture, its quality, and widest of clothes
HAIR = ((1.0, 1.0, 9), (0.42, 1.7, 7), (0.16, 2.8, 5))  # share of the ribbons, how much wider, most steps along one
CAPS = (2_000, 500, 250)  # triangles of the surface below the ribbons
LONGEST = 9  # steps along a ribbon
HEAD_SCALE = 2.3  # a face is looked at most
UV_WEIGHT = 6.0  # or brows bend where a large triangle crosses them
MOVES, WEIGHTS = 10, 4  # directions of face curves and of skin weights that simplification respects


def simplified(character: Character, level: int) -> Character:
    """The character with about the triangles of a level."""
    character, kept = _hair(character, level)
    of = character.materials[character.triangles[:, 0]]
    for i, material in enumerate(MATERIALS):
        if material.name == "hair":
            continue
        faces = character.triangles[of == i]
        target = TRIANGLES[level].get(material.name, len(faces))
        kept.append(_fewer(character, faces, target) if target < len(faces) else faces)
    made = part(character, np.concatenate(kept))
    if level < len(TRIANGLES) - 1:
        return made
    return replace(made, textures=made.textures | dict.fromkeys(DETAILS, b""))  # colours alone


def _hair(character: Character, level: int) -> tuple[Character, list[Int[np.ndarray, "f 3"]]]:
    """The character with wider ribbons, and the triangles of hair that are kept."""
    hair = next(i for i, material in enumerate(MATERIALS) if material.name == "hair")
    faces = character.triangles[character.materials[character.triangles[:, 0]] == hair]
    count = len(character.positions)
    links = coo_array((np.ones(faces.size), (faces.ravel(), np.roll(faces, 1, 1).ravel())), shape=(count, count))
    _, piece = connected_components(links, directed=False)
    pieces = [np.flatnonzero(piece == i) for i in np.unique(piece[faces[:, 0]])]
    share, wider, most = HAIR[level]
    positions, kept = character.positions.copy(), []
    ribbons = [one for one in pieces if len(one) <= 2 * LONGEST]
    for one in (one for one in pieces if len(one) > 2 * LONGEST):
        own = faces[piece[faces[:, 0]] == piece[one[0]]]
        kept.append(_fewer(character, own, CAPS[level]) if CAPS[level] < len(own) else own)
    chosen = np.random.default_rng(43).permutation(len(ribbons))[: round(share * len(ribbons))]
    for one in (ribbons[i] for i in np.sort(chosen)):  # left and right vertices take turns
        pairs = one.reshape(-1, 2)
        middle = positions[pairs].mean(1, keepdims=True)
        positions[pairs] = middle + wider * (positions[pairs] - middle)
        steps = np.unique(np.linspace(0, len(pairs) - 1, min(most, len(pairs))).round().astype(int))
        a, b = pairs[steps[:-1]], pairs[steps[1:]]
        kept += [np.stack([a[:, 0], a[:, 1], b[:, 1]], 1), np.stack([a[:, 0], b[:, 1], b[:, 0]], 1)]
    return replace(character, positions=positions), kept


def part(character: Character, triangles: Int[np.ndarray, "f 3"]) -> Character:
    """Only these triangles, and the vertices that they use, in their old order."""
    used, local = np.unique(triangles, return_inverse=True)
    place = np.full(len(character.positions), -1)
    place[used] = np.arange(len(used))
    face = character.face
    here = place[face.vertices] >= 0
    shape = np.repeat(np.arange(len(face.names)), np.diff(face.starts))[here]
    starts = np.concatenate([[0], np.bincount(shape, minlength=len(face.names)).cumsum()])
    rows = ("positions", "normals", "colours", "uvs", "materials", "joints", "weights")
    return replace(
        character,
        **{name: getattr(character, name)[used] for name in rows},
        triangles=local.reshape(-1, 3).astype(np.int32),
        face=Morphs(face.names, starts, place[face.vertices[here]], face.moves[here], face.turns[here]),
    )


def _fewer(character: Character, faces: Int[np.ndarray, "f 3"], target: int) -> Int[np.ndarray, "g 3"]:
    """About `target` of the triangles' surface, through meshoptimizer."""
    used, local = np.unique(faces, return_inverse=True)
    shown, normals, _ = posed(character, DOWN)
    points = shown[used]
    neck = REST[[i for i, y in enumerate(REST[:, 1]) if y > 1.4]].min(0)[1]
    high = np.clip((points[:, 1:2] - neck) / 0.05, 0, 1)
    warped = points + high * (HEAD_SCALE - 1) * (points - [0, neck, 0])
    extent = float(np.ptp(warped, axis=0).max())
    values = [normals[used], _directions(character, used), _mixed(bone_weights(character)[used]), character.uvs[used]]
    weights = np.repeat([0.25, 2.0 / extent, 0.05, UV_WEIGHT], [3, MOVES, WEIGHTS, 2])
    table = np.concatenate(values, 1).astype(np.float32)
    head = np.array([len(used), table.shape[1], local.size, target * 3], np.int32)
    blob = [head, warped.astype(np.float32), table, weights.astype(np.float32), local.astype(np.uint32)]
    with tempfile.TemporaryDirectory() as folder:
        source, goal = Path(folder) / "in", Path(folder) / "out"
        source.write_bytes(b"".join(np.ascontiguousarray(part).tobytes() for part in blob))
        _node("simplify", source, goal)
        left = np.fromfile(goal, np.uint32)
    return np.asarray(used[left].reshape(-1, 3))


def _directions(character: Character, used: Int[np.ndarray, " v"]) -> Float[np.ndarray, "v m"]:
    """The main directions of what all face curves do to each vertex, in metres."""
    face = character.face
    moves = np.zeros((len(character.positions), len(face.names), 3), np.float32)
    shape = np.repeat(np.arange(len(face.names)), np.diff(face.starts))
    moves[face.vertices, shape] = face.moves
    flat = moves[used].reshape(len(used), -1)
    _, axes = np.linalg.eigh(flat.T @ flat)
    return np.asarray(flat @ axes[:, -MOVES:])


def _mixed(weights: Float[np.ndarray, "v j"]) -> Float[np.ndarray, "v w"]:
    """Skin weights mixed into a few numbers, which differ where weights differ."""
    return np.asarray(weights @ np.random.default_rng(41).uniform(0, 1, (weights.shape[1], WEIGHTS)))


def compress(character: Character, level: int, path: Path) -> None:
    """Write a level as a GLB with meshopt compression and WebP pictures."""
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain.glb"
        plain.write_bytes(pack_glb(character, []))
        _node("compress", plain, path, *PICTURES[level])


def _node(*words: object) -> None:
    if not (TOOLS / "node_modules").is_dir():
        raise SystemExit(f"levels need Node 20 and some packages: run `npm ci` in {TOOLS}")
    subprocess.run(["node", TOOLS / "levels.mjs", *map(str, words)], check=True)


def main() -> None:
    """Write the levels of the named people, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(CHARACTERS), help=f"of {', '.join(CHARACTERS)}")
    parser.add_argument("--out", type=Path, default=FOLDER)
    args = parser.parse_args()
    for name in args.names:
        whole = load_character(name)
        for level in range(len(TRIANGLES)):
            made = simplified(whole, level)
            path = args.out / f"{name}.lod{level}.glb"
            compress(made, level, path)
            print(f"{path.name}: {len(made.triangles)} triangles, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
