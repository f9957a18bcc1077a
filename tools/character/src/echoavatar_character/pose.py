"""The character in a pose that is told by rotation vectors."""

import numpy as np
import torch
from jaxtyping import Float

from echoavatar.files.avatar import Character, skin
from echoavatar.motion.kinematics import HUMANOID, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_axis_angle

Turns = dict[str, tuple[float, float, float]]  # of joints, in radians about the T-pose's axes
DOWN: Turns = {
    "leftUpperArm": (0, 0, -1.2),
    "rightUpperArm": (0, 0, 1.2),
    "leftLowerArm": (0, -0.25, 0),
    "rightLowerArm": (0, 0.25, 0),
}


def posed(
    character: Character, turns: Turns, face: Float[np.ndarray, " n"] | None = None
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"], Float[np.ndarray, "j 3"]]:
    """Vertices in metres, their unit normals, and the places of the joints; `face` holds weights of blendshapes."""
    local = torch.eye(3).repeat(HUMANOID.joints, 1, 1)
    for name, turn in turns.items():
        local[HUMANOID.index(name)] = matrix_from_axis_angle(torch.tensor(turn, dtype=torch.float32))
    pose = forward_kinematics(HUMANOID, local, HUMANOID.rest_positions[0])
    points, normals = skin(character, pose.rotations.numpy(), pose.positions.numpy(), face)
    return points, normals, pose.positions.numpy()
