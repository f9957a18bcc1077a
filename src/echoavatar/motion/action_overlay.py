"""The part of an action that its codes cannot express: small rotations of torso and head, added to finished motion.

First-layer codes keep the arms of a reference clip and lose its nods, head shakes and bows. An overlay holds what the
clip rotates beyond what its codes decode to. A nod that is added on top leaves the hands free for the speech. Not in
the paper.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from jaxtyping import Float
from torch.nn.functional import normalize

from echoavatar.timing import CHUNK, ChunkSize

from .kinematics import Skeleton
from .kinematics.easing import smootherstep
from .kinematics.rotations import quaternion_from_axis_angle, quaternion_multiply
from .motion_chunk import MotionChunk

UNIT = 1e-3  # radians; files hold whole multiples of it


@dataclass(frozen=True, eq=False)
class Overlay:
    """Rotation vectors by joint name, applied after the joint's own rotation; whole chunks."""

    joints: tuple[str, ...]
    rotation_vectors: Float[np.ndarray, "t j 3"]  # radians

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Overlay) or self.joints != other.joints:
            return False
        return np.array_equal(self.rotation_vectors, other.rotation_vectors)

    def chunk(self, place: int, size: ChunkSize = CHUNK) -> "Overlay":
        """One chunk of the overlay."""
        return Overlay(self.joints, self.rotation_vectors[place * size.frames : (place + 1) * size.frames])

    def scaled(self, intensity: float) -> "Overlay":
        """The overlay with every rotation vector multiplied by `intensity`."""
        return Overlay(self.joints, self.rotation_vectors * np.float32(intensity))

    def to_json(self) -> dict[str, list[int]]:
        """Milliradians by joint: x, y, z of one frame, then of the next."""
        rows = np.rint(self.rotation_vectors / UNIT).astype(int)
        return {joint: rows[:, at].reshape(-1).tolist() for at, joint in enumerate(self.joints)}

    @classmethod
    def from_json(cls, rows: dict[str, list[int]]) -> Self:
        """The inverse of `to_json`."""
        vectors = [np.asarray(row, np.float32).reshape(-1, 3) * np.float32(UNIT) for row in rows.values()]
        return cls(tuple(rows), np.stack(vectors, axis=1) if vectors else np.zeros((0, 0, 3), np.float32))


def bridge(before: Overlay | None, now: Overlay | None) -> Overlay | None:
    """The overlay `now` of a chunk, changed to begin where the unrelated overlay `before` ended."""
    if before is None and now is None:
        return None
    names = tuple(dict.fromkeys((*(before.joints if before else ()), *(now.joints if now else ()))))
    frames = len((now or before).rotation_vectors)  # type: ignore[union-attr]  # one of them is there
    last = _of(before, names, frames)[-1]
    vectors = _of(now, names, frames)
    gap = last - vectors[0]
    share = (np.arange(frames, dtype=np.float32) + 1) / frames
    fall = 1 - smootherstep(share)
    return Overlay(names, (vectors + fall[:, None, None] * gap).astype(np.float32))


def apply_overlay(motion: MotionChunk, overlay: Overlay, skeleton: Skeleton) -> MotionChunk:
    """Finished motion with the overlay added."""
    if not overlay.joints:
        return motion
    joints = skeleton.indices(overlay.joints)
    rotations = motion.rotations.copy()
    added = quaternion_from_axis_angle(torch.tensor(overlay.rotation_vectors[: len(rotations)]))
    rotated = quaternion_multiply(torch.from_numpy(rotations[:, joints]), added)
    rotations[:, joints] = normalize(rotated, dim=-1).numpy()
    return motion._replace(rotations=rotations)


def _of(overlay: Overlay | None, names: tuple[str, ...], frames: int) -> Float[np.ndarray, "t j 3"]:
    """Rotation vectors of these joints, zero for those that the overlay lacks."""
    vectors = np.zeros((frames, len(names), 3), np.float32)
    if overlay is not None:
        for at, name in enumerate(overlay.joints):
            vectors[:, names.index(name)] = overlay.rotation_vectors[:, at]
    return vectors
