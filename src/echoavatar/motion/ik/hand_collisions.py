"""Hands kept out of torso, neck and head (paper, Online Post-Processing), for many sessions at once.

As in the paper there is no detection and no optimisation. A smooth map of space moves points inside the body to its
surface, along the local horizontal, and leaves points outside a thin shell where they are. The arm follows its hand.
The map sees one frame at a time: it has no state, so it cannot drift, and the chunking does not matter.

Departures from the paper:

- The body is a stack of ellipsoids that bend with spine and head, instead of a cylinder in the pelvis' axes.
- The way out starts at a line near the back and the far side, where no hand passes, instead of at the axis. A hand that
  sweeps through the axis therefore slides along the front. Around the head the way out also leads upwards.
- All points of a hand move the same way, as far as the deepest of them needs. One step frees wrist, palm and fingers.
- The elbow bends too, so that the hand meets the target's distance and not only its direction.
- The hand keeps its orientation in the world, and there is no smallest correction.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.errors import MotionError

from ..kinematics import Skeleton
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from .body import Body
from .chains import Array, ChainPose, Chains
from .hand import HandPoint, hand_points
from .hand_shift import SHELL, Tables, keep_off
from .profile import BodyProfile, body_of_rig

CLEARANCE = 0.006  # metres of air between hand and body
BEHIND, ACROSS = 0.70, 0.30  # where the way out starts, in half depths and half widths of a part
TOLERANCE = 0.01  # relative error of the squared norm of a rotation matrix
SIDES = ("left", "right")


class HandCollisions:
    """Moves arms so that no hand is inside the body. The motion of a rig whose arms are not known passes unchanged."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile | None = None) -> None:
        self.is_able = _has_arms(skeleton)
        self.joints: list[int] = []
        if not self.is_able:
            return
        self.profile = profile or body_of_rig(skeleton)
        bones, body = bone_map(skeleton), Body(skeleton, self.profile)
        self._body, self._hands = body, _common_points(skeleton, bones)
        self.joints = body.joints + [point.joint for hand in self._hands for point in hand]
        own = [self.profile.palm if point.is_palm else self.profile.finger for point in self._hands[0]]
        self._thicker = np.array(own, np.float32) - np.float32(min(own))
        self._radii = body.radii + np.float32(min(own) + CLEARANCE)
        self._zone = _zone(self._radii, _span(skeleton, self._hands[0]) + SHELL + float(self._thicker.max()))
        self._arms = [[bones[f"{side}{bone}"] for bone in ("UpperArm", "LowerArm", "Hand")] for side in SIDES]
        self._skeleton = skeleton
        self.use_chains(Chains(skeleton, self.joints))

    def use_chains(self, chains: Chains) -> None:
        """Use the caller's chains, which must hold `joints`, so that their pose is computed only once."""
        if not self.is_able:
            return

        def slots(joints: list[list[int]]) -> Array:
            return np.array([[chains.slot[joint] for joint in row] for row in joints], np.int64)

        parents = self._skeleton.parents
        is_head = [part.bone == "head" for part in self._body.parts]
        self._chains = chains
        self._tables = Tables(
            carriers=slots([self._body.joints])[0],
            centres=self._body.centres,
            radii=self._radii,
            zone=self._zone,
            starts=_starts(self._body),
            is_head=np.array(is_head),
            points=slots([[point.joint for point in hand] for hand in self._hands]),
            offsets=np.array([[point.offset for point in hand] for hand in self._hands], np.float32),
            thicker=self._thicker,
            arms=slots(self._arms),
            above=slots([[parents[joint] for joint in arm] for arm in self._arms]),
            joints=np.array(self._arms, np.int64),
        )

    def resolve(self, rotations: Float[Array, "b t j 4"], chains: ChainPose) -> None:
        """Correct upper arms, forearms and hands in place where a hand is inside; `chains` is the pose's."""
        if self.is_able:
            keep_off(self._tables, chains, rotations)

    def step(
        self, rotations: Float[Tensor, "b t j 3 3"], active: Bool[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b t j 3 3"]:
        """`resolve` for parent-relative rotation matrices of any number of frames.

        Frames and arms that need no correction return bit for bit. Not differentiable; `swing_clear` is.

        Raises:
            MotionError: an active row holds rotations that are not finite or not normalised.
        """
        if not self.is_able:
            return rotations
        given = rotations.detach().cpu().float()
        self._check(given[:, :, self._chains.joints].numpy(), active)
        quaternions = quaternion_from_matrix(given).numpy()
        resolved = quaternions.copy()
        self.resolve(resolved, self._chains.pose(quaternions))
        is_moved = torch.from_numpy((resolved != quaternions).any(-1))
        if not is_moved.any():
            return rotations
        given = given.clone()
        given[is_moved] = matrix_from_quaternion(torch.from_numpy(resolved)[is_moved])
        return given.to(rotations)

    def _check(self, rotations: Float[Array, "b t c 3 3"], active: Tensor | None) -> None:
        size = np.einsum("btcij,btcij->btc", rotations, rotations) - 3
        bad = ~(np.abs(size) < 3 * TOLERANCE)  # true for NaN too
        if active is not None:
            bad &= active.cpu().numpy()[:, None, None]
        if not bad.any():
            return
        row, frame, joint = (int(index) for index in np.argwhere(bad)[0])
        value = rotations[row, frame, joint]
        problem = "is not normalised" if np.isfinite(value).all() else "is not finite"
        raise MotionError(
            f"the rotation of {self._skeleton.names[self._chains.joints[joint]]} in row {row}, frame {frame}"
            f" {problem} ({np.array2string(value.flatten(), precision=3)}); normalise the quaternions or 6D features"
            " it was made of, and leave out frames that are not finite"
        )


def _has_arms(skeleton: Skeleton) -> bool:
    try:
        bones = bone_map(skeleton)
    except MotionError:
        return False
    needed = [f"{side}{bone}" for side in SIDES for bone in ("UpperArm", "LowerArm", "Hand")]
    return all(bone in bones for bone in (*needed, "hips", "head"))


def _common_points(skeleton: Skeleton, bones: dict[str, int]) -> list[list[HandPoint]]:
    """Points of both hands, in the same order; fingers that either hand lacks are left out."""
    swap = {"left": "right", "right": "left"}
    both = {
        name: joint
        for name, joint in bones.items()
        if not name.startswith(SIDES) or swap[side := name[: 4 + name.startswith("right")]] + name[len(side) :] in bones
    }
    return [hand_points(skeleton, both, side) for side in SIDES]


def _starts(body: Body) -> Float[Array, "2 e 3"]:
    """Where the way out of each part starts, from the part's centre: on the right for the left hand, and vice versa."""
    starts = np.zeros((2, len(body.parts), 3), np.float32)
    starts[:, :, 0] = ACROSS * body.radii[:, 0] * np.array([[-1.0], [1.0]])
    starts[:, :, 2] = -BEHIND * body.radii[:, 2]
    return starts


def _span(skeleton: Skeleton, hand: list[HandPoint]) -> float:
    """The greatest distance between the middle of the palm and a point of the hand, for any bend of fingers; metres."""
    wrist, palm = hand[0].joint, hand[1].offset
    far = 0.0
    for point in hand:
        length, joint = float(np.linalg.norm(point.offset)), point.joint
        while joint != wrist and skeleton.parents[joint] != wrist:
            length += float(skeleton.offsets[joint].norm())
            joint = skeleton.parents[joint]
        base = np.zeros(3) if joint == wrist else skeleton.offsets[joint].numpy()
        far = max(far, length + float(np.linalg.norm(base - palm)))
    return far


def _zone(radii: Float[Array, "e 3"], distance: float) -> Float[Array, "e 3"]:
    """Radii of ellipsoids that contain every point within `distance` of the ellipsoids of `radii`."""
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((4000, 3)).astype(np.float32)
    squares = np.square(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    needed = np.sqrt(squares @ np.square(radii).T) + distance
    wide = radii + np.float32(distance)
    held = np.sqrt(squares @ np.square(wide).T)
    zone: Array = wide * (1.002 * (needed / held).max(0))[:, None]
    return zone
