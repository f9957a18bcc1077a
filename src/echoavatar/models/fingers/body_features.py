"""Body features that the finger model is conditioned on, independent of heading (paper: "the remaining body joints").

For each hand, in axes at the hips that face +Z: the wrist's position (metres) and velocity (metres per second), the
hand's orientation (6D) and the direction of the forearm; then the hips' velocity forward and to the left, and their
height. Joint rotations are left out, because they identify rig and person, which prevents generalisation.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_to_6d
from echoavatar.timing import FRAME_RATE_HZ

from .hand_poses import FINGERS, MIRROR_6D

_WRISTS = HUMANOID.indices(("leftHand", "rightHand"))
_ELBOWS = HUMANOID.indices(("leftLowerArm", "rightLowerArm"))
_HAND = 3 + 3 + 6 + 3
BODY_SIZE = 2 * _HAND + 3


def body_features(rotations: Float[Tensor, "t 52 3 3"], root: Float[Tensor, "t 3"]) -> Float[Tensor, "t c"]:
    """Features of a clip of `HUMANOID` at 30 frames per second; they do not depend on the fingers."""
    flat_handed = rotations.clone()
    flat_handed[:, list(FINGERS)] = torch.eye(3, dtype=flat_handed.dtype)
    pose = forward_kinematics(HUMANOID, flat_handed, root)
    back = _heading(pose.rotations[:, 0]).transpose(-1, -2)
    wrists = (back[:, None] @ (pose.positions[:, _WRISTS] - root[:, None])[..., None]).squeeze(-1)
    elbows = (back[:, None] @ (pose.positions[:, _ELBOWS] - root[:, None])[..., None]).squeeze(-1)
    palms = matrix_to_6d(back[:, None] @ pose.rotations[:, _WRISTS])
    hands = torch.cat([wrists, _velocity(wrists), palms, F.normalize(wrists - elbows, dim=-1)], -1)
    travel = (back @ _velocity(root)[..., None]).squeeze(-1)
    return torch.cat([hands.flatten(1), travel[:, [2, 0]], root[:, 1:2]], -1)


def mirror_body(features: Float[Tensor, "*n c"]) -> Float[Tensor, "*n c"]:
    """Features of the mirrored clip; exact, because only signs and order change."""
    hands, hips = torch.split(features, [2 * _HAND, 3], -1)
    flip = features.new_tensor([-1.0, 1, 1])
    swapped = hands.reshape(*hands.shape[:-1], 2, _HAND).flip(-2)
    hands = (swapped * torch.cat([flip, flip, features.new_tensor(MIRROR_6D), flip])).flatten(-2)
    return torch.cat([hands, hips * features.new_tensor([1.0, -1, 1])], -1)


def _heading(hips: Float[Tensor, "t 3 3"]) -> Float[Tensor, "t 3 3"]:
    """Rotation about the vertical that takes +X to the character's left."""
    x, z = hips[:, 0, 0], hips[:, 2, 0]
    length = torch.hypot(x, z).clamp_min(1e-6)
    cosine, sine, zero = x / length, z / length, torch.zeros_like(x)
    one = torch.ones_like(x)
    rows = [cosine, zero, -sine, zero, one, zero, sine, zero, cosine]
    return torch.stack(rows, -1).reshape(-1, 3, 3)


def _velocity(places: Tensor) -> Tensor:
    """Velocity per second by central differences; zero for a single frame."""
    if len(places) < 2:
        return torch.zeros_like(places)
    speed: Tensor = torch.gradient(places, spacing=1 / FRAME_RATE_HZ, dim=0)[0]
    return speed
