import numpy as np

from echoavatar.pipeline import MotionChunk


def test_a_chunk_is_rotations_then_root_and_perhaps_a_face() -> None:
    rotations, root, face = MotionChunk(np.zeros((8, 52, 4)), np.zeros((8, 3)))
    assert rotations.shape == (8, 52, 4)
    assert root.shape == (8, 3)
    assert face is None
