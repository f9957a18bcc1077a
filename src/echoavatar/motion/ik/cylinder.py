"""The paper's cylinder for a character that has none of its own, from its thickness (paper, Online Post-Processing).

The paper shapes the cylinder by hand "based on the model width". Here its radius at a height is the half width of the
body's part there (`BodyProfile`), plus half the thickness of a palm. `swing_clear` is the rule.
"""

import numpy as np
import torch
from jaxtyping import Float

from ..kinematics import Skeleton
from ..kinematics.rigs import bone_map
from ..kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from .profile import BodyProfile, body_of_rig
from .swing import SwingConfig, swing_clear


class Cylinder:
    """Keeps both hands outside a cylinder around the spine."""

    def __init__(self, skeleton: Skeleton, profile: BodyProfile | None = None) -> None:
        """Raises MotionError when the rig's bones are not known."""
        bones, body = bone_map(skeleton), profile or body_of_rig(skeleton)
        rest, self._skeleton = skeleton.rest_positions, skeleton
        hips = float(rest[bones["hips"], 1])
        widths = {
            round(float(rest[bones[part.bone], 1]) + part.centre[1] - hips, 4): part.radii[0] + body.palm
            for part in body.parts
            if part.bone in bones
        }
        self.config = SwingConfig.model_validate({"profile": sorted(widths.items())})
        self._arms = tuple((bones[f"{side}UpperArm"], bones[f"{side}Hand"]) for side in ("left", "right"))

    def resolve(self, rotations: Float[np.ndarray, "b t j 4"]) -> Float[np.ndarray, "b t j 4"]:
        """The same parent-relative quaternions with both upper arms swung clear."""
        matrices = matrix_from_quaternion(torch.from_numpy(rotations))
        clear = swing_clear(self._skeleton, matrices, self.config, self._arms)
        changed = rotations.copy()
        for shoulder, _ in self._arms:
            turned = quaternion_from_matrix(clear[..., shoulder, :, :]).numpy()
            changed[..., shoulder, :] = np.where(turned[..., :1] < 0, -turned, turned)
        return changed
