import numpy as np

from echoavatar.motion.motion_chunk import MotionBatch, MotionChunk, join_batches


def test_a_chunk_is_rotations_then_root_and_perhaps_a_face() -> None:
    rotations, root, face = MotionChunk(np.zeros((8, 52, 4)), np.zeros((8, 3)))
    assert rotations.shape == (8, 52, 4)
    assert root.shape == (8, 3)
    assert face is None


def test_a_batch_in_two_pieces_is_parted_session_by_session() -> None:
    rotations, root = (np.random.default_rng(0).random((3, 12, *each)) for each in ((52, 4), (3,)))
    faces = np.random.default_rng(1).random((3, 12, 52))
    batch = join_batches([MotionBatch(rotations[:, :8], root[:, :8]), MotionBatch(rotations[:, 8:], root[:, 8:])])
    for row, chunk in enumerate(batch.split(faces)):
        for found, wanted in zip(chunk, (rotations, root, faces), strict=True):
            np.testing.assert_array_equal(found, wanted[row])
    assert [chunk.face for chunk in batch.split(None)] == [None] * 3
