import numpy as np

from echoavatar.files.avatar import Character
from echoavatar.files.avatar.halfway import BONES, PARENTS, SOURCES
from echoavatar.motion.kinematics import HUMANOID, SkinWeights


def bone_weights(character: Character) -> np.ndarray:
    """Weights as one matrix (v, b) over all `BONES`."""
    dense = np.zeros((len(character.positions), len(BONES)), np.float32)
    rows = np.arange(len(dense))[:, None].repeat(4, 1)
    np.add.at(dense, (rows, character.joints), character.weights)
    return dense


def humanoid_weights(character: Character) -> np.ndarray:
    """Weights over the joints of our rig: those of a halfway bone go to its bone and to its parent in halves."""
    dense, halves = np.split(bone_weights(character), [HUMANOID.joints], axis=1)
    dense[:, SOURCES] += halves / 2
    for row, parent in enumerate(PARENTS):
        dense[:, parent] += halves[:, row] / 2
    return dense


def as_skin(dense: np.ndarray) -> SkinWeights:
    """A matrix (v, j) as the body's measures take it."""
    return SkinWeights(np.broadcast_to(np.arange(dense.shape[1]), dense.shape), dense)
