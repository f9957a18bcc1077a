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
from ..kinematics import Skeleton
from ..kinematics.rigs import bone_map
from .arm import reach
from .body import Body, to_unit
from .chains import Array, Chains, Points
from .hand import HandPoint, hand_points
from .profile import BodyProfile, body_of_rig

CLEARANCE = 0.006  # metres of air between hand and body
SHELL = 0.035  # metres before contact at which a hand begins to give way
BEHIND, ACROSS = 0.70, 0.30  # of a part's half depth and half width: where the way out starts
FOCUS = 3  # how sharply the nearest part alone decides the way out
TOLERANCE = 0.01  # of the squared size of a rotation matrix
SIDES = ("left", "right")


class HandGuard:
    """Moves arms so that no hand is inside the body; a rig whose arms are not known is passed through."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile | None = None) -> None:
        self.is_able = _has_arms(skeleton)
        if not self.is_able:
            return
        self.profile = profile or body_of_rig(skeleton)
        bones, body = bone_map(skeleton), Body(skeleton, self.profile)
        hands = _common_points(skeleton, bones)
        self._chains = Chains(skeleton, body.joints + [point.joint for hand in hands for point in hand])
        slot = self._chains.slot
        self._points = Points(
            np.array([slot[point.joint] for hand in hands for point in hand]),
            np.array([point.offset for hand in hands for point in hand], np.float32).T,
        )
        own = [self.profile.palm if point.is_palm else self.profile.finger for point in hands[0]]
        self._thicker = np.array(own, np.float32)[:, None] - min(own)
        self._carriers, self._centres = body.slots(self._chains), body.centres
        self._radii = body.radii + np.float32(min(own) + CLEARANCE)
        self._starts, self._is_head = _starts(body)
        arms = [[bones[f"{side}{bone}"] for side in SIDES] for bone in ("UpperArm", "LowerArm", "Hand")]
        self._arms = np.array([[slot[joint] for joint in pair] for pair in arms])
        self._above = np.array([[slot[skeleton.parents[joint]] for joint in pair] for pair in arms])
        self._changed = np.array([joint for pair in arms for joint in pair])
        self._names = skeleton.names

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
        fixed = self._corrected(local, frames, move)
        changed = flat.copy()
        changed[:, self._changed] = fixed.transpose(4, 2, 3, 0, 1).reshape(len(flat), -1, 3, 3)
        return torch.from_numpy(changed.reshape(given.shape)).to(rotations)

    def _moves(self, frames: Float[Array, "3 4 c n"]) -> Float[Array, "3 2 n"]:
        """By how much each hand is moved, in the root's frame."""
        bones = frames[:, :, self._carriers]
        axes, seen = to_unit(bones, self._centres, self._radii, self._points.place(frames))
        seen = seen.reshape(3, len(self._carriers), 2, -1, seen.shape[-1])
        way = self._ways(bones, seen[:, :, :, 1])
        ahead = np.einsum("ijen,jan->iean", axes, way)
        a = np.einsum("iean,iean->ean", ahead, ahead)[:, :, None]
        b = np.einsum("iean,ieapn->eapn", ahead, seen)
        c = np.einsum("ieapn,ieapn->eapn", seen, seen)
        root = b * b - a * (c - 1)
        exits = (np.sqrt(np.maximum(root, 0)) - b) / a + self._thicker
        exits = np.where(root > 0, exits, -1)
        short = np.square(np.minimum(np.maximum(exits + SHELL, 0), 2 * SHELL)) / (4 * SHELL)
        short += np.maximum(exits - SHELL, 0)  # (e, a, p, n): how far each point must go to leave each part
        eighth = np.square(np.square(np.square(short / SHELL))).sum(0).sum(1)
        moves: Array = way * (SHELL * eighth**0.125)  # the most of them, without a corner where two are equal
        return moves

    def _ways(self, bones: Float[Array, "3 4 e n"], seen: Float[Array, "3 e 2 n"]) -> Float[Array, "3 2 n"]:
        """Unit direction in which each hand leaves the body: away from the nearest parts' starting points."""
        near = (np.einsum("iean,iean->ean", seen, seen) + 0.25) ** -FOCUS
        away = seen * self._radii[:, :, None, None] - self._starts
        away[1] = np.maximum(away[1], 0) * self._is_head
        ways: Array = np.einsum("ijen,jean->ian", bones[:, :3], away * near)
        ways /= np.maximum(np.sqrt(np.einsum("ian,ian->an", ways, ways)), 1e-9)
        return ways

    def _corrected(
        self, local: Float[Array, "4 4 c n"], frames: Float[Array, "3 4 c n"], move: Float[Array, "3 2 n"]
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
        new = np.einsum("jivan,jkvan->ikvan", above, children)
        return np.where(move.any(0), new, local[:3, :3][:, :, self._arms])

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
