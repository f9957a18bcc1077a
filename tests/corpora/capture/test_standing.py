import numpy as np
import pytest

from echoavatar.corpora.capture.library import CapturedLibrary
from echoavatar.corpora.capture.standing import IDLE, TALKING, standing
from echoavatar.errors import MotionError


def test_a_body_of_any_length_stands_near_its_place_and_faces_the_front(people: CapturedLibrary):
    body = standing(people, 1500, np.random.default_rng(0), liveliness=TALKING)
    assert len(body) == 1500
    assert np.abs(body.pelvis_position[:, [0, 2]]).max() < 1.0
    assert np.abs(body.pelvis_rotation[:, 0]).mean() < 0.6
    again = standing(people, 1500, np.random.default_rng(0), liveliness=TALKING)
    np.testing.assert_array_equal(body.packed(), again.packed())


def test_who_talks_moves_more_than_who_waits(people: CapturedLibrary):
    def moves(liveliness: float) -> float:
        bodies = [standing(people, 900, np.random.default_rng(seed), liveliness=liveliness) for seed in range(3)]
        return float(np.mean([np.linalg.norm(np.diff(b.pelvis_position, axis=0), axis=1).mean() for b in bodies]))

    assert moves(TALKING) > 1.15 * moves(IDLE)


def test_a_library_needs_somebody_who_stands(people: CapturedLibrary):
    with pytest.raises(MotionError, match="standing longer than 4 s"):
        standing(CapturedLibrary(people.of("speech")), 300, np.random.default_rng(0), liveliness=IDLE)
