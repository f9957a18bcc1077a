from typing import get_args

import numpy as np
import pytest
from lab.tests.evaluation.metrics.swings import swing

from echoavatar_lab.evaluation.metrics.dance_alignment import DanceForm, dance_alignment, dance_beats

RESTS = np.arange(41) * 0.5


@pytest.mark.parametrize("form", get_args(DanceForm))
def test_beats_of_a_pendulum_are_where_it_stands_still(form: DanceForm) -> None:
    """Speed |sin| is least, and brakes hardest, at every half second; smoothing over 5 frames keeps both."""
    found = dance_beats(swing(1.0), form)
    assert len(found) > 30
    assert np.abs(found[:, None] - RESTS).min(1).max() < 0.07


def test_events_are_compared_in_the_direction_of_the_form() -> None:
    """Four clicks, a dancer on one of them: AIST++ is content, the others find three clicks unanswered."""
    music, motion = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0])
    assert dance_alignment(motion, music, "aist") == 1
    for form in ("paper", "bailando", "sharp"):
        assert dance_alignment(motion, music, form) == pytest.approx(0.25, abs=1e-6)


def test_sigma_in_frames_is_wider_at_a_lower_rate() -> None:
    """A tenth of a second is 6 frames at 60 fps, 3 at 30: exp(-2) and exp(-1/2). In seconds the rate plays no part."""
    music, motion = np.array([1.0]), np.array([1.1])
    for fps, expected in ((60, np.exp(-2)), (30, np.exp(-0.5))):
        assert dance_alignment(motion, music, "bailando", fps=fps) == pytest.approx(expected)
    assert dance_alignment(motion, music, "sharp", fps=60) == dance_alignment(motion, music, "sharp", fps=30)
