import numpy as np

from echoavatar.files.avatar import Character
from echoavatar.files.avatar.halfway import PARENTS, SOURCES
from echoavatar.motion.kinematics import HUMANOID


def humanoid_weights(character: Character) -> np.ndarray:
    """Weights over the joints of our rig: those of a halfway bone go to its bone and to its parent in halves."""
    dense, halves = np.split(character.bone_weights.copy(), [HUMANOID.joints], axis=1)
    dense[:, SOURCES] += halves / 2
    for row, parent in enumerate(PARENTS):
        dense[:, parent] += halves[:, row] / 2
    return dense
