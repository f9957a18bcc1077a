"""Make the character: signed distances -> meshes -> baked light -> skin weights -> one npz.

Run `python -m echoavatar_character.make [OUT]`; deterministic, under a minute on one core.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from echoavatar.files.avatar.character import MATERIALS, Character

from .face_bake import face_morphs, neutral
from .figure import PIECES, Piece, piece_colours, piece_mesh
from .figure_eyes import EYE, EYE_RADIUS, LASH, eyeball, lashes
from .figure_mouth import closed, inside_mask, lip_mask
from .figure_teeth import teeth, tongue
from .rigging import smooth, strongest, weigh
from .sculpt import Mesh
from .sdf import mirrored, sphere

SHIPPED = Path(__file__).parents[4] / "src" / "echoavatar" / "assets" / "character.npz"
BEHIND_EYES = 0.0025  # metres into an eyeball at which skin is never seen
SMOOTHED = ("jacket", "ribbing", "zips", "stripes", "pockets", "shirt", "crew neck", "trousers", "turn-ups")


def main() -> None:
    """Make the character and save it."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED
    out.parent.mkdir(parents=True, exist_ok=True)
    character = build()
    character.save(out)
    print(
        f"{out}: {len(character.positions)} vertices, {len(character.triangles)} triangles, {out.stat().st_size} bytes"
    )


class Part(NamedTuple):
    """A finished surface; for a part of the face, `side` says which lip each vertex goes with."""

    name: str
    material: str
    mesh: Mesh
    colours: np.ndarray
    side: np.ndarray | None = None


def build() -> Character:
    """The whole character in the rest pose; the parts that expressions move come first."""
    parts = [sculpted(piece) for piece in PIECES] + face_parts()
    parts.sort(key=lambda part: part.side is None)
    joints, weights = strongest(all_weights(parts))
    starts = np.cumsum([0, *(len(part.mesh.positions) for part in parts)])
    names = [material.name for material in MATERIALS]
    return Character(
        positions=np.concatenate([part.mesh.positions for part in parts]),
        normals=np.concatenate([part.mesh.normals for part in parts]),
        colours=np.clip(np.round(np.concatenate([part.colours for part in parts])), 0, 255).astype(np.uint8),
        materials=np.concatenate(
            [np.full(len(part.mesh.positions), names.index(part.material), np.uint8) for part in parts]
        ),
        joints=joints,
        weights=weights,
        triangles=np.concatenate([part.mesh.triangles + start for part, start in zip(parts, starts, strict=False)]),
        face=face_morphs([(part.name, part.mesh, part.side) for part in parts if part.side is not None]),
    )


def sculpted(piece: Piece) -> Part:
    """Mesh, colour and shade a piece; the mouth of the head is closed."""
    mesh = without_buried(piece, piece_mesh(piece))
    colours = piece_colours(piece, mesh.positions.astype(np.float64)) * shade(piece, mesh)[:, None]
    print(f"  {piece.name:13s}{len(mesh.triangles):6d} triangles")
    if piece.name == "head":
        mesh, side = neutral(mesh)
        return Part("skin", piece.material, mesh, colours, side)
    on_face = np.ones(len(mesh.positions)) if piece.name == "brows" else None
    return Part(piece.name, piece.material, mesh, colours, on_face)


def face_parts() -> list[Part]:
    """Eyes, lashes, teeth and tongue."""
    made = [
        *(("lashes", "hair", painted(lashes(side), LASH)) for side in (1.0, -1.0)),
        ("left eye", "eye", eyeball(1.0)),
        ("right eye", "eye", eyeball(-1.0)),
        ("upper teeth", "mouth", teeth(upper=True)),
        ("lower teeth", "mouth", teeth(upper=False)),
        ("tongue", "mouth", tongue()),
    ]
    return [
        Part(name, material, mesh, colours, np.ones(len(mesh.positions))) for name, material, (mesh, colours) in made
    ]


def painted(mesh: Mesh, colour: tuple[int, int, int]) -> tuple[Mesh, np.ndarray]:
    """A mesh in one colour."""
    return mesh, np.tile(np.asarray(colour, np.float64), (len(mesh.positions), 1))


def all_weights(parts: list[Part]) -> np.ndarray:
    """The weights of every vertex; those of cloth are smoothed across its layers."""
    points = [part.mesh.positions.astype(np.float64) for part in parts]
    weights = [weigh(part.name, p) for part, p in zip(parts, points, strict=True)]
    cloth = [i for i, part in enumerate(parts) if part.name in SMOOTHED]
    merged = smooth(np.concatenate([weights[i] for i in cloth]), np.concatenate([points[i] for i in cloth]), passes=8)
    for i, part in zip(cloth, np.split(merged, np.cumsum([len(points[i]) for i in cloth])[:-1]), strict=True):
        weights[i] = part
    return np.concatenate(weights)


def without_buried(piece: Piece, mesh: Mesh) -> Mesh:
    """The mesh without triangles that lie deep inside other pieces, unused vertices dropped."""
    depth = np.full(len(mesh.positions), np.inf)
    for other in PIECES:
        if other is not piece:
            near = inside_box(other, mesh.positions)
            depth[near] = np.minimum(depth[near], other.field(mesh.positions[near].astype(np.float64)))
    eyes = sphere(mirrored(mesh.positions.astype(np.float64)), EYE, EYE_RADIUS)
    depth[eyes < -BEHIND_EYES] = -1
    kept = mesh.triangles[(depth[mesh.triangles] > -piece.buried).any(1)]
    used, compact = np.unique(kept, return_inverse=True)
    return Mesh(mesh.positions[used], mesh.normals[used], compact.reshape(-1, 3).astype(np.int32))


def shade(piece: Piece, mesh: Mesh) -> np.ndarray:
    """The ambient light at each vertex, 0..1, from the distances along its normal."""
    light = np.ones(len(mesh.positions))
    for reach, strength in ((0.004, 0.16), (0.010, 0.16), (0.022, 0.16)):
        points = mesh.positions.astype(np.float64) + mesh.normals * reach
        clear = np.full(len(points), reach)
        for other in PIECES:
            near = inside_box(other, points)
            clear[near] = np.minimum(clear[near], other.field(points[near]))
        light -= strength * np.clip((reach - clear) / reach, 0, 1.4)
    if piece.name == "head":  # closed lips hide less from the light than the modelled, open ones
        points = mesh.positions.astype(np.float64)
        light[(lip_mask(closed(points)) < 0.001) & (inside_mask(points) > 0)] = 1
    return np.clip(light, 0.35, 1)


def inside_box(piece: Piece, points: np.ndarray) -> np.ndarray:
    """Which points lie in the piece's box."""
    return np.asarray(((points > piece.low) & (points < piece.high)).all(1))


if __name__ == "__main__":
    main()
