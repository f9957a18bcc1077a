"""Input of our motion autoencoder: pose and travel in the body's own frame.

Where a clip faces or stands must not count as a difference between motions, so heading and place are left out; turning
and travelling are kept. Per frame: 6D rotations of all joints with the hips facing +Z, the root's step sideways and
forwards (m/s), its turning speed (rad/s), its height (m).
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, matrix_to_6d
from echoavatar.timing import FRAME_RATE_HZ

from .position_error import heading, turn_about_up

TRAVEL = 4


def motion_features(rotations: Float[Tensor, "t j 4"], root: Float[Tensor, "t 3"]) -> Float[Tensor, "t c"]:
    """Features of a clip at 30 fps, 6 j + 4 a frame; the first frame repeats the second one's travel."""
    matrices = matrix_from_quaternion(rotations.float())
    yaw = heading(matrices[:, 0])
    back = turn_about_up(yaw)
    matrices = torch.cat([(back @ matrices[:, 0])[:, None], matrices[:, 1:]], 1)
    step = torch.zeros_like(root, dtype=torch.float32)
    turn = torch.zeros(len(root))
    if len(root) > 1:
        step[1:] = (back[:-1] @ root.float().diff(dim=0)[..., None])[..., 0]
        turn[1:] = (yaw.diff() + math.pi).remainder(2 * math.pi) - math.pi
        step[0], turn[0] = step[1], turn[1]
    travel = torch.stack([step[:, 0], step[:, 2], turn], -1) * FRAME_RATE_HZ
    return torch.cat([matrix_to_6d(matrices).flatten(1), travel, root[:, 1:2].float()], -1)


def feature_count(joints: int) -> int:
    """Values a frame: 316 for our rig."""
    return 6 * joints + TRAVEL
