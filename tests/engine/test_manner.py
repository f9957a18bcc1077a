import numpy as np
import pytest
from tests.engine.fakes import engine

from echoavatar.engine.manner import DRIFT, SpeakerManner
from echoavatar.models.generator.manner import MANNER, draw_manner
from echoavatar.motion.stages.modes import FREE, MotionOptions


def test_it_wanders_slowly_around_what_the_seed_drew():
    manner = SpeakerManner(7, FREE)
    minutes = np.stack([manner.at(chunk) for chunk in range(900)])
    assert np.abs(minutes - draw_manner(7).values).max() <= DRIFT + 1e-6
    assert np.abs(np.diff(minutes, axis=0)).max() < 0.01
    assert np.ptp(minutes[:, MANNER.index("liveliness")]) > 0.05
    assert np.array_equal(minutes, np.stack([SpeakerManner(7, FREE).at(chunk) for chunk in range(900)]))
    assert not np.array_equal(SpeakerManner(8, FREE).at(0), minutes[0])


def test_what_is_set_holds_and_the_rest_stays():
    manner = SpeakerManner(7, MotionOptions(liveliness=0.2))
    before = manner.at(50)
    assert before[MANNER.index("liveliness")] == np.float32(0.2)
    manner.choose(handedness=0.0)
    after = manner.at(50)
    assert after[MANNER.index("right")] == 0
    others = [name not in ("liveliness", "right") for name in MANNER]
    assert np.array_equal(before[others], SpeakerManner(7, FREE).at(50)[others])
    assert after[MANNER.index("liveliness")] == np.float32(0.2)


def test_a_session_is_told_its_manner_and_numbers_out_of_range_are_refused():
    with engine().open(seed=3, options=MotionOptions(liveliness=0.4)) as session:
        session.core.set_manner(handedness=1.0)
        session.push(np.zeros(6_400, np.float32))
        plan = session.core.begin_chunk(0)
        assert plan.manner[MANNER.index("liveliness")] == np.float32(0.4)
        assert plan.manner[MANNER.index("right")] == 1
        with pytest.raises(ValueError, match="liveliness"):
            session.core.set_manner(liveliness=1.5)
