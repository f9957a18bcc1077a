"""Build the character: signed distances -> meshes -> baked shade -> skin weights -> one npz (extra `character`).

Run `python scripts/make_character.py [OUT]`; deterministic, under a minute on one core.
"""

import sys
from pathlib import Path

import numpy as np

from echoavatar.avatar.character import MATERIALS, Character
from echoavatar.avatar.figure import PIECES, Piece, eyeball, piece_colours, piece_mesh
from echoavatar.avatar.rigging import smooth, strongest, weigh
from echoavatar.avatar.sculpt import Mesh

SHIPPED = Path(__file__).parents[1] / "src" / "echoavatar" / "assets" / "character.npz"
SMOOTHED = (
    "jacket",
    "ribbing",
    "zips",
    "stripes",
    "pockets",
    "shirt",
    "crew neck",
    "trousers",
    "turn-ups",
)


def main() -> None:
    """Build and save."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED
    out.parent.mkdir(parents=True, exist_ok=True)
    character = build()
    character.save(out)
    print(
        f"{out}: {len(character.positions)} vertices, {len(character.triangles)} triangles, {out.stat().st_size} bytes"
    )


def build() -> Character:
    """The whole character in the rest pose."""
    parts: list[tuple[str, str, Mesh, np.ndarray]] = []
    for piece in PIECES:
        mesh = without_buried(piece, piece_mesh(piece))
        colours = piece_colours(piece, mesh.positions.astype(np.float64)) * shade(piece, mesh)[:, None]
        parts.append((piece.name, piece.material, mesh, colours))
        print(f"  {piece.name:13s}{len(mesh.triangles):6d} triangles")
    parts += [("eye", "eye", *eyeball(side)) for side in (1.0, -1.0)]
    joints, weights = strongest(all_weights(parts))
    starts = np.cumsum([0, *(len(mesh.positions) for _, _, mesh, _ in parts)])
    names = [material.name for material in MATERIALS]
    return Character(
        positions=np.concatenate([mesh.positions for _, _, mesh, _ in parts]),
        normals=np.concatenate([mesh.normals for _, _, mesh, _ in parts]),
        colours=np.clip(np.round(np.concatenate([c for _, _, _, c in parts])), 0, 255).astype(np.uint8),
        materials=np.concatenate(
            [np.full(len(m.positions), names.index(kind), np.uint8) for _, kind, m, _ in parts]
        ),
        joints=joints,
        weights=weights,
        triangles=np.concatenate(
            [mesh.triangles + start for (_, _, mesh, _), start in zip(parts, starts, strict=False)]
        ),
    )


def all_weights(parts: list[tuple[str, str, Mesh, np.ndarray]]) -> np.ndarray:
    """Weights of every vertex; cloth is smoothed together, across its layers."""
    points = [mesh.positions.astype(np.float64) for _, _, mesh, _ in parts]
    weights = [weigh(name, p) for (name, *_), p in zip(parts, points, strict=True)]
    cloth = [i for i, (name, *_) in enumerate(parts) if name in SMOOTHED]
    merged = smooth(
        np.concatenate([weights[i] for i in cloth]), np.concatenate([points[i] for i in cloth]), passes=8
    )
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
    kept = mesh.triangles[(depth[mesh.triangles] > -piece.buried).any(1)]
    used, compact = np.unique(kept, return_inverse=True)
    return Mesh(mesh.positions[used], mesh.normals[used], compact.reshape(-1, 3).astype(np.int32))


def shade(piece: Piece, mesh: Mesh) -> np.ndarray:
    """Ambient light that reaches each vertex, 0..1, from the distances met along its normal."""
    light = np.ones(len(mesh.positions))
    for reach, strength in ((0.004, 0.16), (0.010, 0.16), (0.022, 0.16)):
        points = mesh.positions.astype(np.float64) + mesh.normals * reach
        clear = np.full(len(points), reach)
        for other in PIECES:
            near = inside_box(other, points)
            clear[near] = np.minimum(clear[near], other.field(points[near]))
        light -= strength * np.clip((reach - clear) / reach, 0, 1.4)
    return np.clip(light, 0.35, 1)


def inside_box(piece: Piece, points: np.ndarray) -> np.ndarray:
    """Which points lie in the piece's box."""
    return ((points > piece.low) & (points < piece.high)).all(1)


if __name__ == "__main__":
    main()
