"""Retarget a stream frame by frame. `retarget` measures on the whole clip; this measures on the two rest poses.

Both rigs must stand upright in their rest pose. Planted feet are not corrected here: the stages behind the decoder do
that on the live path.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.errors import MotionError

from .alignment import align
from .forward import forward_kinematics
from .retarget import leg_length, local_rotations
from .rigs import bone_map
from .skeleton import HUMANOID, Skeleton


class Retargeted(NamedTuple):
    """Frames on the target rig. The target's root is `scale` times the source's plus `offset`, metres."""

    rotations: Float[Tensor, "n j 3 3"]
    offset: Float[Tensor, "n 3"]


class LiveRetarget:
    """Retargets from one rig to another, each frame by itself."""

    def __init__(self, source: Skeleton, target: Skeleton = HUMANOID) -> None:
        """Both rigs in metres, Y up, facing +Z.

        Raises:
            MotionError: the source's bones are not known, or its rest pose does not stand upright.
        """
        theirs, ours = bone_map(source), bone_map(target)
        rest = source.rest_positions
        if not rest[theirs["head"], 1] > rest[theirs["hips"], 1] > rest[theirs["leftFoot"], 1]:
            raise MotionError("the rest pose of the rig does not stand upright (Y up, metres); rotate it first")
        self.source, self.target = source, target
        self.scale = leg_length(target, ours) / leg_length(source, theirs)
        still = torch.eye(3, dtype=torch.double).expand(1, source.joints, 3, 3)
        pose = forward_kinematics(source, still, rest[:1].double())
        found = align(source, pose, theirs, target, ours)
        self._rotations = {ours[bone]: (theirs[bone], rotation.float()) for bone, rotation in found.items()}
        legs, feet = ("leftUpperLeg", "rightUpperLeg"), ("leftFoot", "rightFoot")
        self._their_legs, self._our_legs = ([bones[leg] for leg in legs] for bones in (theirs, ours))
        ankles = [ours[foot] for foot in feet]
        self._floor = 0.0
        moved = self(still.float())
        standing = forward_kinematics(target, moved.rotations, self.scale * rest[:1] + moved.offset)
        self._floor = float(target.rest_positions[ankles, 1].mean() - standing.positions[0, ankles, 1].min())

    def __call__(self, rotations: Float[Tensor, "n j 3 3"]) -> Retargeted:
        """Retarget parent-relative rotations of the source."""
        nowhere = rotations.new_zeros(len(rotations), 3)
        pose = forward_kinematics(self.source, rotations, nowhere)
        world = {joint: pose.rotations[:, bone] @ rotation for joint, (bone, rotation) in self._rotations.items()}
        local = local_rotations(self.target, world, len(rotations)).to(rotations)
        middle = pose.positions[:, self._their_legs].mean(1) * self.scale
        placed = forward_kinematics(self.target, local, nowhere).positions[:, self._our_legs].mean(1)
        return Retargeted(local, middle - placed + nowhere.new_tensor([0.0, self._floor, 0.0]))
