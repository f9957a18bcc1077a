import numpy as np
import pytest
from lab.tests.corpora.capture.people import library

from echoavatar.errors import MotionError
from echoavatar_lab.corpora.capture.library import CapturedLibrary
from echoavatar_lab.corpora.capture.standing import IDLE, TALKING, standing


def test_who_waits_never_does_what_talkers_do():
    people = library()
    calm, lively = (standing(people, 900, np.random.default_rng(3), liveliness=x) for x in (IDLE, TALKING))
    assert len(calm) == len(lively) == 900
    assert np.ptp(calm.pelvis_position[:, 0]) < 0.05 < np.ptp(lively.pelvis_position[:, 0])


def test_a_library_without_anybody_who_stands_is_refused():
    people = library()
    with pytest.raises(MotionError, match="standing"):
        standing(CapturedLibrary(people.of("speech")), 90, np.random.default_rng(0), liveliness=IDLE)
