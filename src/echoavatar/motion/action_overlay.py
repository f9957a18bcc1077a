"""The part of an action that its codes cannot express: rotations of torso and head, and the clip's arms and hands.

First-layer codes keep the arms of a reference clip roughly, lose its nods, head shakes and bows, and know nothing of
fingers. An overlay holds what the clip rotates torso and head beyond what its codes decode to; a nod that is added on
top leaves the hands free for the speech. Where hands must meet, touch or point, it also holds the clip's own arms and
fingers, which replace the generated ones. Not in the paper.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from jaxtyping import Float

from echoavatar.timing import CHUNK, ChunkSize

from .kinematics import Skeleton
from .kinematics.easing import smootherstep
from .kinematics.rotations import (
    axis_angle_from_quaternion,
    quaternion_from_axis_angle,
    quaternion_multiply,
    slerp,
    unit,
)
from .motion_chunk import MotionChunk

UNIT = 1e-3  # radians; files hold whole multiples of it


@dataclass(frozen=True, eq=False)
class Hands:
    """Rotations that replace those of the joints, as far as `shares` says; they last whole chunks."""

    joints: tuple[str, ...]
    rotations: Float[np.ndarray, "t h 4"]  # relative to the parent, wxyz
    shares: Float[np.ndarray, "t h"]  # 0 keeps the joint's own rotation, 1 replaces it

    def to_json(self) -> dict[str, Any]:
        """Milliradians by joint, of one frame where they do not change; shares in thousandths, one for all joints."""
        vectors = axis_angle_from_quaternion(self.rotations)
        rows = np.rint(vectors / UNIT).astype(int)
        turns = {
            joint: (row[:1] if (row == row[:1]).all() else row).reshape(-1).tolist()
            for joint, row in zip(self.joints, rows.swapaxes(0, 1), strict=True)
        }
        return {"shares": np.rint(self.shares[:, 0] * 1000).astype(int).tolist(), "joints": turns}

    @classmethod
    def from_json(cls, stored: dict[str, Any]) -> Self:
        """The inverse of `to_json`. Raises ValueError: rotations are not finite, or shares are not 0 to 1."""
        shares = np.asarray(stored["shares"], np.float32) / 1000
        names = tuple(stored["joints"])
        vectors = np.empty((len(shares), len(names), 3), np.float32)
        for at, row in enumerate(stored["joints"].values()):
            vectors[:, at] = np.asarray(row, np.float32).reshape(-1, 3)
        rotations = quaternion_from_axis_angle(vectors * np.float32(UNIT))
        if not (np.isfinite(rotations).all() and ((shares >= 0) & (shares <= 1)).all()):
            raise ValueError("rotations of hands that are not finite, or shares that are not from 0 to 1")
        return cls(names, rotations, np.repeat(shares[:, None], len(names), axis=1))


def no_hands(frames: int) -> Hands:
    """Hands that replace nothing, for this many frames."""
    return Hands((), np.zeros((frames, 0, 4), np.float32), np.zeros((frames, 0), np.float32))


@dataclass(frozen=True, eq=False)
class Overlay:
    """Hands, and rotation vectors by joint name, applied after the joint's own rotation; both last whole chunks."""

    joints: tuple[str, ...]
    rotation_vectors: Float[np.ndarray, "t j 3"]  # radians
    hands: Hands = field(default_factory=lambda: no_hands(0))

    def __post_init__(self) -> None:
        if not self.hands.joints:
            object.__setattr__(self, "hands", no_hands(len(self.rotation_vectors)))

    def chunk(self, place: int, size: ChunkSize = CHUNK) -> "Overlay":
        """One chunk of the overlay."""
        here, hands = slice(place * size.frames, (place + 1) * size.frames), self.hands
        hands = replace(hands, rotations=hands.rotations[here], shares=hands.shares[here])
        return Overlay(self.joints, self.rotation_vectors[here], hands)

    def scaled(self, intensity: float) -> "Overlay":
        """The overlay with every rotation vector and hand share multiplied by `intensity`, hand shares by 1 at most."""
        hands = replace(self.hands, shares=self.hands.shares * np.float32(min(intensity, 1.0)))
        return Overlay(self.joints, self.rotation_vectors * np.float32(intensity), hands)

    def to_json(self) -> dict[str, list[int]]:
        """Milliradians by joint: x, y, z of one frame, then of the next. `Hands.to_json` gives the hands."""
        rows = np.rint(self.rotation_vectors / UNIT).astype(int)
        return {joint: rows[:, at].reshape(-1).tolist() for at, joint in enumerate(self.joints)}

    @classmethod
    def from_json(cls, rows: dict[str, list[int]], hands: dict[str, Any] | None = None) -> Self:
        """The inverse of both `to_json`. Raises ValueError: values are not finite, or shares are not 0 to 1."""
        held = no_hands(0) if hands is None else Hands.from_json(hands)
        vectors = [np.asarray(row, np.float32).reshape(-1, 3) * np.float32(UNIT) for row in rows.values()]
        if not all(np.isfinite(row).all() for row in vectors):
            raise ValueError("turns that are not finite")
        empty = np.zeros((len(held.shares), 0, 3), np.float32)
        return cls(tuple(rows), np.stack(vectors, axis=1) if vectors else empty, held)


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
    turned = (vectors + fall[:, None, None] * gap).astype(np.float32)
    return Overlay(names, turned, _bridged_hands(before, now, (1 - fall).astype(np.float32)))


def _bridged_hands(before: Overlay | None, now: Overlay | None, rise: Float[np.ndarray, " t"]) -> Hands:
    """Hands that begin as those of `before` ended and become those of `now` while `rise` goes to 1."""
    old, new = before.hands if before else no_hands(len(rise)), now.hands if now else no_hands(len(rise))
    names = tuple(dict.fromkeys((*old.joints, *new.joints)))
    rotations, shares = np.zeros((len(rise), len(names), 4), np.float32), np.zeros((len(rise), len(names)), np.float32)
    for at, name in enumerate(names):
        ways = [(hands.joints.index(name), hands) for hands in (old, new) if name in hands.joints]
        last = [hands.rotations[-1 if hands is old else slice(None), i] for i, hands in ways]
        counts = [hands.shares[-1 if hands is old else slice(None), i] for i, hands in ways]
        if len(ways) == 2:
            rotations[:, at] = slerp(np.broadcast_to(last[0], (len(rise), 4)), last[1], rise)
            shares[:, at] = counts[0] + rise * (counts[1] - counts[0])
        else:
            rotations[:, at] = last[0]
            shares[:, at] = counts[0] * (1 - rise if ways[0][1] is old else rise)
    return Hands(names, rotations, shares)


def apply_overlay(motion: MotionChunk, overlay: Overlay, skeleton: Skeleton) -> MotionChunk:
    """Finished motion with the overlay's rotations added; the overlay's hands replace those of the motion."""
    rotations, frames = motion.rotations.copy(), len(motion.rotations)
    if overlay.joints:
        joints = skeleton.indices(overlay.joints)
        added = quaternion_from_axis_angle(overlay.rotation_vectors[:frames])
        rotations[:, joints] = unit(quaternion_multiply(rotations[:, joints], added))
    if overlay.hands.joints:
        joints = skeleton.indices(overlay.hands.joints)
        wanted, shares = overlay.hands.rotations[:frames], overlay.hands.shares[:frames]
        rotations[:, joints] = slerp(rotations[:, joints], wanted, shares)
    return motion._replace(rotations=rotations)


def _of(overlay: Overlay | None, names: tuple[str, ...], frames: int) -> Float[np.ndarray, "t j 3"]:
    """Rotation vectors of these joints, zero for those that the overlay lacks."""
    vectors = np.zeros((frames, len(names), 3), np.float32)
    if overlay is not None:
        for at, name in enumerate(overlay.joints):
            vectors[:, names.index(name)] = overlay.rotation_vectors[:, at]
    return vectors
