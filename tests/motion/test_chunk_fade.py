import numpy as np
import pytest

from echoavatar.motion.chunk_fade import KEPT, ChunkFade


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
