"""Morph targets: what each blendshape adds to the vertices of the neutral face, kept sparse."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from echoavatar.errors import MotionError
from echoavatar.nn.kernels import kernel

MOVE_UNIT = 2e-6  # metres; how moves are stored
TURN_UNIT = 1 / 64  # how changes of normals are stored
LEAST_MOVE, LEAST_TURN = 1.5e-4, 0.06  # what is less is left out


@dataclass(frozen=True)
class Morphs:
    """Shapes on the first `reach` vertices of a mesh; entries of shape i are starts[i]..starts[i + 1].

    Attributes:
        names: of the shapes, in order.
        starts: (n + 1,) borders between the shapes' entries.
        vertices: (m,) the vertex of each entry, ascending within a shape.
        moves: (m, 3) metres at a weight of 1.
        turns: (m, 3) change of the normal at a weight of 1, before normals are made unit again.
    """

    names: tuple[str, ...]
    starts: Int[np.ndarray, " n1"]
    vertices: Int[np.ndarray, " m"]
    moves: Float[np.ndarray, "m 3"]
    turns: Float[np.ndarray, "m 3"]

    @cached_property
    def reach(self) -> int:
        """All moving vertices are before this one."""
        return int(self.vertices.max(initial=-1)) + 1

    def part(self, index: int) -> slice:
        """The entries of one shape."""
        return slice(int(self.starts[index]), int(self.starts[index + 1]))

    def arrays(self) -> dict[str, Any]:
        """Small arrays for an npz."""
        return {
            "face_names": np.array(self.names),
            "face_starts": self.starts.astype(np.int32),
            "face_vertices": self.vertices.astype(np.uint16),
            "face_moves": np.round(self.moves / MOVE_UNIT).astype(np.int16),
            "face_turns": np.clip(np.round(self.turns / TURN_UNIT), -127, 127).astype(np.int8),
        }

    @classmethod
    def of_arrays(cls, stored: Mapping[str, np.ndarray]) -> "Morphs":
        """What `arrays` made."""
        return cls(
            tuple(str(name) for name in stored["face_names"]),
            stored["face_starts"].astype(np.int64),
            stored["face_vertices"].astype(np.int64),
            stored["face_moves"].astype(np.float32) * np.float32(MOVE_UNIT),
            stored["face_turns"].astype(np.float32) * np.float32(TURN_UNIT),
        )

    @classmethod
    def of_dense(
        cls, names: Sequence[str], moves: Float[np.ndarray, "n v 3"], turns: Float[np.ndarray, "n v 3"]
    ) -> "Morphs":
        """Sparse shapes from full ones; tiny changes are left out."""
        entries = [
            np.flatnonzero((np.abs(move).max(1) > LEAST_MOVE) | (np.abs(turn).max(1) > LEAST_TURN))
            for move, turn in zip(moves, turns, strict=True)
        ]
        return cls(
            tuple(names),
            np.cumsum([0, *(len(e) for e in entries)]),
            np.concatenate(entries),
            np.concatenate([move[e] for move, e in zip(moves, entries, strict=True)]).astype(np.float32),
            np.concatenate([turn[e] for turn, e in zip(turns, entries, strict=True)]).astype(np.float32),
        )


def checked_face(curves: ArrayLike, frames: int, shapes: int = 52) -> Float[np.ndarray, "t n"]:
    """Curves as float32, clipped to 0..1; raises `MotionError` when they do not fit motion or character."""
    face = np.asarray(curves, np.float32)
    if face.shape != (frames, shapes):
        raise MotionError(f"the face has shape {face.shape}; {frames} frames take ({frames}, {shapes})")
    if not np.isfinite(face).all():
        raise MotionError("the face holds values that are not finite; repair it before export")
    return np.clip(face, 0, 1)


@kernel(fastmath=True)
def added(weights, starts, vertices, moves, turns, positions, normals, reach):  # type: ignore[no-untyped-def]
    """Add the shapes with weights (n) to `positions` and `normals` (v, 3), and make the first `reach` normals unit."""
    for shape in range(weights.shape[0]):
        weight = np.float32(weights[shape])
        if weight != 0:
            for entry in range(starts[shape], starts[shape + 1]):
                v = vertices[entry]
                for i in range(3):
                    positions[v, i] += weight * moves[entry, i]
                    normals[v, i] += weight * turns[entry, i]
    for v in range(reach):
        length = normals[v, 0] ** 2 + normals[v, 1] ** 2 + normals[v, 2] ** 2
        scale = np.float32(1.0) / max(np.sqrt(length), np.float32(1e-9))
        for i in range(3):
            normals[v, i] *= scale
