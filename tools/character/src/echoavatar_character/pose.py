"""The character in a pose that is told by rotation vectors."""

import numpy as np
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
    local = np.tile(np.eye(3, dtype=np.float32), (HUMANOID.joints, 1, 1))
    for name, turn in turns.items():
        local[HUMANOID.index(name)] = matrix_from_axis_angle(np.array(turn, np.float32))
    rotations, places = forward_kinematics(HUMANOID, local, HUMANOID.rest_positions[0])
    points, normals = skin(character, rotations, places, face)
    return points, normals, places
