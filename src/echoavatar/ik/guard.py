"""Hands kept out of torso, neck and head (paper, Online Post-Processing), for many sessions at once.

As in the paper there is no detection and no optimisation: a smooth map of space that leaves everything outside a thin
shell where it is and takes what is inside to the surface, along the local horizontal, and an arm that follows. The map
looks at one frame at a time, so it keeps no state, cannot drift, and chunks do not matter.

Departures from the paper. The shape is a stack of ellipsoids that bend with spine and head instead of a cylinder in the
pelvis' axes. The way out of it starts not at the axis but at a line near the back and the far side, where no hand
passes, so a hand that sweeps through the axis slides along the front; around the head it also leads upwards. All points
of the hand travel the same way, as far as the one that needs it most, so wrist, palm, thumb and fingers are out in one
step. The elbow bends too, so that the hand gets the target's distance and not its direction alone; the hand keeps its
orientation in the world; and there is no smallest correction.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from ..errors import MotionError
from ..kinematics import Skeleton, lanes
from ..kinematics.rigs import bone_map
from .arm import reach
from .body import Body, unit_axes
from .chains import Array, Chains, Points
from .hand import HandPoint, hand_points
from .profile import BodyProfile, body_of_rig

CLEARANCE = 0.006  # metres of air between hand and body
SHELL = 0.035  # metres before contact at which a hand begins to give way
BEHIND, ACROSS = 0.70, 0.30  # of a part's half depth and half width: where the way out starts
_STEEP = 1e9
TOLERANCE = 0.01  # of the squared size of a rotation matrix
SIDES = ("left", "right")


class HandGuard:
    """Moves arms so that no hand is inside the body; a rig whose arms are not known is passed through."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile | None = None) -> None:
        self.is_able = _has_arms(skeleton)
        self.joints: list[int] = []
        if not self.is_able:
            return
        self.profile = profile or body_of_rig(skeleton)
        bones, body = bone_map(skeleton), Body(skeleton, self.profile)
        hands = _common_points(skeleton, bones)
        self._body, self._hands = body, [point for both in zip(*hands, strict=True) for point in both]
        self.joints = body.joints + [point.joint for point in self._hands]
        own = [self.profile.palm if point.is_palm else self.profile.finger for point in hands[0]]
        self._thicker = np.array(own, np.float32)[:, None] - min(own)
        self._centres = body.centres
        self._radii = body.radii + np.float32(min(own) + CLEARANCE)
        self._starts, self._is_head = _starts(body)
        zone = _zone(self._radii, _span(skeleton, hands[0]) + SHELL + float(self._thicker.max()))
        self._zone = np.square(self._radii / zone)[:, :, None, None]
        arms = [[bones[f"{side}{bone}"] for side in SIDES] for bone in ("UpperArm", "LowerArm", "Hand")]
        self._arm_joints = np.array(arms)
        self._above_joints = np.array([[skeleton.parents[joint] for joint in pair] for pair in arms])
        self._changed = np.array([joint for pair in arms for joint in pair])
        self._names = skeleton.names
        self.stand_on(Chains(skeleton, self.joints))

    def stand_on(self, chains: Chains) -> None:
        """Read poses from these chains, which must hold `joints`: a caller has them worked out already."""
        if not self.is_able:
            return
        self._chains, slot = chains, chains.slot
        self._points = Points(
            np.array([slot[point.joint] for point in self._hands]),
            np.array([point.offset for point in self._hands], np.float32).T,
        )
        self._carriers = self._body.slots(chains)
        self._arms, self._above = (
            np.array([[slot[joint] for joint in pair] for pair in joints])
            for joints in (self._arm_joints, self._above_joints)
        )

    def step(
        self, rotations: Float[Tensor, "b t j 3 3"], active: Bool[Tensor, " b"] | None = None
    ) -> Float[Tensor, "b t j 3 3"]:
        """The same parent-relative rotations with upper arms, forearms and hands corrected where a hand is inside.

        Frames and arms that need nothing come back bit for bit. Not differentiable; `swing_clear` is.

        Raises:
            MotionError: an active row holds rotations that are not finite or not normalised.
        """
        if not self.is_able:
            return rotations
        given = rotations.detach().cpu().numpy()
        flat = given.reshape(-1, *given.shape[2:]).astype(np.float32, copy=False)
        local = self._chains.local(flat)
        self._check(local, rotations.shape[0], active)
        frames = self._chains.world(local)
        move = self._moves(frames)
        if not move.any():
            return rotations
        fixed = self._corrected(frames, move)
        fixed = np.where(move.any(0), fixed, local[:3, :3][:, :, self._arms])
        changed = flat.copy()
        changed[:, self._changed] = fixed.transpose(4, 2, 3, 0, 1).reshape(len(flat), -1, 3, 3)
        return torch.from_numpy(changed.reshape(given.shape)).to(rotations)

    def guard(self, turns: Float[Array, "4 j n"], frames: Float[Array, "3 4 c n"]) -> None:
        """The same for the live path: quaternions of whole poses, changed in place, and their frames in the chains."""
        if not self.is_able:
            return
        move = self._moves(frames)
        near = move.any((0, 1))
        if not near.any():
            return
        if not near.all():
            frames, move = frames[..., near], move[..., near]
        fixed = lanes.from_matrix(self._corrected(frames, move))
        which = move.any(0)
        for joints, new in zip(self._arm_joints, fixed.transpose(1, 0, 2, 3), strict=True):
            old = turns[:, joints][..., near]
            turns[:, joints[:, None], np.flatnonzero(near)] = np.where(which, new, old)

    def _moves(self, frames: Float[Array, "3 4 c n"]) -> Float[Array, "3 2 n"]:
        """By how much each hand is moved, in the root's frame.

        Of all parts, hands and frames only those are worked out in which some point of the hand could be near.
        """
        bones, points = frames[:, :, self._carriers], self._points.place(frames)
        parts, n = bones.shape[2:]
        points = points.reshape(3, -1, 2, n)
        axes, middles = unit_axes(bones, self._centres, self._radii)
        seen = np.einsum("ijen,jan->iean", axes, points[:, 1]) - middles[:, :, None]  # the palms
        way = self._ways(bones, seen)
        near = np.flatnonzero(lanes.dot(seen, seen * self._zone) < 1)  # of all parts, hands, frames
        reached = np.zeros((parts, 2, n), np.float32)
        if len(near):
            frame, hand_frame = near % n, near % (2 * n)
            part_frame = near // (2 * n) * n + frame
            axes = axes.reshape(3, 3, -1).take(part_frame, 2)
            ahead = lanes.apply(axes, way.reshape(3, -1).take(hand_frame, 1))
            there = points.reshape(3, -1, 2 * n).take(hand_frame, 2)
            seen = np.einsum("ijk,jpk->ipk", axes, there)
            seen -= middles.reshape(3, -1).take(part_frame, 1)[:, None]
            reached.reshape(-1)[near] = self._eighth(ahead, seen)
        far = (
            SHELL * np.add.reduce(reached) ** 0.125
        )  # the most of them, without a corner where two are equal
        moves: Array = way * far
        return moves

    def _eighth(self, ahead: Float[Array, "3 k"], seen: Float[Array, "3 p k"]) -> Float[Array, " k"]:
        """Sum over a hand's points of the eighth power of how far each must go to leave a part, in shells."""
        a, c = lanes.dot(ahead, ahead), lanes.dot(seen, seen)
        b = lanes.dot(np.broadcast_to(ahead[:, None], seen.shape), seen)
        root = b * b - a * (c - 1)
        exits = np.sqrt(np.maximum(root, 0))
        exits -= b
        exits /= a
        exits += self._thicker
        np.minimum(exits, root * _STEEP - 1, out=exits)  # a way that misses the part needs no exit
        short = np.square(np.minimum(np.maximum(exits + SHELL, 0), 2 * SHELL)) * (0.25 / SHELL)
        short += np.maximum(exits - SHELL, 0)
        short *= 1 / SHELL
        eighths: Array = np.add.reduce(np.square(np.square(np.square(short))))
        return eighths

    def _ways(self, bones: Float[Array, "3 4 e n"], seen: Float[Array, "3 e 2 n"]) -> Float[Array, "3 2 n"]:
        """Unit direction in which each hand leaves the body: away from the nearest parts' starting points."""
        near = np.reciprocal(lanes.dot(seen, seen) + 0.25)
        away = seen * self._radii[:, :, None, None] - self._starts
        away[1] = np.maximum(away[1], 0) * self._is_head
        away *= near * near * near  # sharp enough that the nearest part alone decides the way out
        ways: Array = np.einsum("ijen,jean->ian", bones[:, :3], away)
        return lanes.normalized(ways)

    def _corrected(
        self, frames: Float[Array, "3 4 c n"], move: Float[Array, "3 2 n"]
    ) -> Float[Array, "3 3 3 2 n"]:
        """New local rotations, (row, column, joint of the arm, side, frame)."""
        arms, above = frames[:, :, self._arms], frames[:, :3][:, :, self._above]
        shoulder, elbow, wrist = arms[:, 3].transpose(1, 0, 2, 3)
        turns = reach(shoulder, elbow, wrist, wrist + move)
        bent = np.stack([arms[:, :3, 1], above[:, :, 2]], 2)  # the forearm, and what carries the hand
        bent = np.einsum("ijan,jkvan->ikvan", turns.bend, bent)
        swung = np.stack([arms[:, :3, 0], bent[:, :, 1]], 2)
        swung = np.einsum("ijan,jkvan->ikvan", turns.swing, swung)
        above[:, :, 2] = swung[:, :, 1]
        children = np.stack([swung[:, :, 0], bent[:, :, 0], arms[:, :3, 2]], 2)
        new: Array = np.einsum("jivan,jkvan->ikvan", above, children)
        return new

    def _check(self, local: Float[Array, "4 4 c n"], rows: int, active: Tensor | None) -> None:
        size = np.einsum("ijcn,ijcn->cn", local[:3, :3], local[:3, :3]) - 3
        if np.abs(size).max(initial=0) < 3 * TOLERANCE:  # false for NaN too
            return
        bad = ~(np.abs(size) < 3 * TOLERANCE)
        bad = bad.reshape(len(bad), rows, -1)
        if active is not None:
            bad &= active.cpu().numpy()[:, None]
        if not bad.any():
            return
        joint, row, frame = (int(index) for index in np.argwhere(bad)[0])
        value = local.reshape(4, 4, len(bad), rows, -1)[:3, :3, joint, row, frame]
        problem = "is not normalised" if np.isfinite(value).all() else "is not finite"
        raise MotionError(
            f"the rotation of {self._names[self._chains.joints[joint]]} in row {row}, frame {frame} {problem}"
            f" ({np.array2string(value.flatten(), precision=3)}); normalise the quaternions or 6D features it"
            " was made of, and leave out frames that are not finite"
        )


def _has_arms(skeleton: Skeleton) -> bool:
    try:
        bones = bone_map(skeleton)
    except MotionError:
        return False
    needed = [f"{side}{bone}" for side in SIDES for bone in ("UpperArm", "LowerArm", "Hand")]
    return all(bone in bones for bone in (*needed, "hips", "head"))


def _common_points(skeleton: Skeleton, bones: dict[str, int]) -> list[list[HandPoint]]:
    """Points of both hands, in the same order; fingers that one hand lacks are left out on both."""
    swap = {"left": "right", "right": "left"}
    both = {
        name: joint
        for name, joint in bones.items()
        if not name.startswith(SIDES)
        or swap[side := name[: 4 + name.startswith("right")]] + name[len(side) :] in bones
    }
    return [hand_points(skeleton, both, side) for side in SIDES]


def _starts(body: Body) -> tuple[Float[Array, "3 e 2 1"], Float[Array, " e 1 1"]]:
    """Where the way out of each part starts for each hand, from the part's centre; and which parts are the head."""
    side = np.array([-1.0, 1.0])  # the left hand starts on the right
    starts = np.zeros((3, len(body.parts), 2, 1), np.float32)
    starts[0, :, :, 0] = ACROSS * body.radii[0][:, None] * side
    starts[2, :, :, 0] = -BEHIND * body.radii[2][:, None]
    is_head = np.array([part.bone == "head" for part in body.parts], np.float32)
    return starts, is_head[:, None, None]


def _span(skeleton: Skeleton, hand: list[HandPoint]) -> float:
    """How far from the middle of its palm a point of the hand can be, however the fingers are bent; metres."""
    wrist, palm = hand[0].joint, hand[1].offset
    far = 0.0
    for point in hand:
        length, joint = float(np.linalg.norm(point.offset)), point.joint
        while joint != wrist and skeleton.parents[joint] != wrist:
            length += float(skeleton.offsets[joint].norm())
            joint = skeleton.parents[joint]
        foot = np.zeros(3) if joint == wrist else skeleton.offsets[joint].numpy()
        far = max(far, length + float(np.linalg.norm(foot - palm)))
    return far


def _zone(radii: Float[Array, "3 e"], distance: float) -> Float[Array, "3 e"]:
    """Radii of ellipsoids that hold all that is nearer to those of `radii` than `distance`."""
    rng = np.random.default_rng(0)
    way = lanes.normalized(rng.standard_normal((3, 4000)).astype(np.float32))
    asked = np.sqrt(np.square(radii).T @ np.square(way)) + distance
    wide = radii + np.float32(distance)
    held = np.sqrt(np.square(wide).T @ np.square(way))
    zone: Array = wide * (1.002 * (asked / held).max(1))
    return zone
