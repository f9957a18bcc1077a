"""The part of an action that its codes cannot say: small rotation_vectors of torso and head, put on top of finished motion.

First-layer codes hold the arms and lose nods, shakes of the head and bows (of a nod of 14 degrees the decoded code
keeps none), so what a reference clip rotation_vectors beyond what its codes decode to is kept and added. Not in the paper.
A nod that is put on top leaves the hands free to go on with the speech.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from jaxtyping import Float
from torch.nn.functional import normalize

from echoavatar.timing import CHUNK, ChunkSize

from .kinematics import Skeleton
from .kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from .motion_chunk import MotionChunk

UNIT = 1e-3  # radians, of what is written to files


@dataclass(frozen=True, eq=False)
class Overlay:
    """Turns by joint name: rotation vectors after the joint's own rotation, whole chunks."""

    joints: tuple[str, ...]
    rotation_vectors: Float[np.ndarray, "t j 3"]  # radians

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Overlay) and self.joints == other.joints and np.array_equal(self.rotation_vectors, other.rotation_vectors)

    def chunk(self, place: int, size: ChunkSize = CHUNK) -> "Overlay":
        """One chunk of it."""
        return Overlay(self.joints, self.rotation_vectors[place * size.frames : (place + 1) * size.frames])

    def scaled(self, intensity: float) -> "Overlay":
        """The same rotation_vectors, more or less of them."""
        return Overlay(self.joints, self.rotation_vectors * np.float32(intensity))

    def to_json(self) -> dict[str, list[int]]:
        """Milliradians by joint: x, y, z of one frame, then of the next."""
        rows = np.rint(self.rotation_vectors / UNIT).astype(int)
        return {joint: rows[:, at].reshape(-1).tolist() for at, joint in enumerate(self.joints)}

    @classmethod
    def from_json(cls, rows: dict[str, list[int]]) -> Self:
        """The inverse of `to_json`."""
        rotation_vectors = [np.asarray(row, np.float32).reshape(-1, 3) * np.float32(UNIT) for row in rows.values()]
        return cls(tuple(rows), np.stack(rotation_vectors, axis=1) if rotation_vectors else np.zeros((0, 0, 3), np.float32))


def bridge(before: Overlay | None, now: Overlay | None) -> Overlay | None:
    """The overlay of a chunk that does not follow from the one before it: it begins where that one ended."""
    if before is None and now is None:
        return None
    names = tuple(dict.fromkeys((*(before.joints if before else ()), *(now.joints if now else ()))))
    frames = len((now or before).rotation_vectors)  # type: ignore[union-attr]  # one of them is there
    last = _of(before, names, frames)[-1]
    rotation_vectors = _of(now, names, frames)
    gap = last - rotation_vectors[0]
    share = (np.arange(frames, dtype=np.float32) + 1) / frames
    fall = 1 - share**3 * (10 - share * (15 - 6 * share))
    return Overlay(names, (rotation_vectors + fall[:, None, None] * gap).astype(np.float32))


def apply_overlay(motion: MotionChunk, overlay: Overlay, skeleton: Skeleton) -> MotionChunk:
    """Finished motion with the overlay's rotation_vectors on top."""
    if not overlay.joints:
        return motion
    joints = skeleton.indices(overlay.joints)
    rotations = motion.rotations.copy()
    rotation_vectors = quaternion_from_axis_angle(torch.tensor(overlay.rotation_vectors[: len(rotations)]))
    turned = quaternion_multiply(torch.from_numpy(rotations[:, joints]), rotation_vectors)
    rotations[:, joints] = normalize(turned, dim=-1).numpy()
    return motion._replace(rotations=rotations)


def _of(overlay: Overlay | None, names: tuple[str, ...], frames: int) -> Float[np.ndarray, "t j 3"]:
    """Turns of these joints, zero for those it does not hold."""
    rotation_vectors = np.zeros((frames, len(names), 3), np.float32)
    if overlay is not None:
        for at, name in enumerate(overlay.joints):
            rotation_vectors[:, names.index(name)] = overlay.rotation_vectors[:, at]
    return rotation_vectors
