import numpy as np
import pytest

from echoavatar.motion.motion_chunk import KEPT, ChunkFade, MotionBatch, MotionChunk, join_batches


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


def test_it_rises_and_falls_at_its_own_speeds() -> None:
    """Half a second is 15 frames, so after 8 it has come by 8/15; a fall of 4 frames ends within the chunk."""
    fade = ChunkFade(0.5, 4 / 30)
    np.testing.assert_allclose(fade.shares(0, is_wanted=True), np.arange(1, 9) / 15)
    np.testing.assert_allclose(fade.shares(1, is_wanted=False)[:3], [8 / 15 - 0.25, 8 / 15 - 0.5, 0])
    assert ChunkFade(1.0, 1.0, start=1.0).shares(0, is_wanted=False)[0] == pytest.approx(29 / 30)


def test_a_chunk_that_is_made_again_is_the_same_as_long_as_it_is_remembered() -> None:
    fade = ChunkFade(0.5, 0.5)
    first = [fade.shares(chunk, is_wanted=chunk % 2 == 0) for chunk in range(KEPT + 10)]
    np.testing.assert_array_equal(fade.shares(20, is_wanted=True), first[20])
    assert fade.shares(9, is_wanted=True)[0] == pytest.approx(1 / 15)  # the end of chunk 8 is forgotten
