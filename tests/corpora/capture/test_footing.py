from dataclasses import replace

import numpy as np

from echoavatar.corpora.capture.footing import stepping
from echoavatar.corpora.rehearsal.controls import ANKLE_HEIGHT, neutral


def test_shuffles_become_steps_and_stances_are_still():
    body = neutral(120)
    place = body.foot_position.copy()
    place[:, 0, 2] += np.interp(np.arange(120), [40, 55], [0.0, 0.12])
    place[:, 1, 0] += 0.003 * np.sin(np.arange(120) / 10)
    feet = stepping(replace(body, foot_position=place)).foot_position
    assert feet[40:56, 0, 1].max() > ANKLE_HEIGHT + 0.02
    np.testing.assert_allclose(feet[100, 0], place[100, 0], atol=0.01)
    assert np.ptp(feet[:, 1], axis=0).max() < 1e-6
    assert np.ptp(feet[:35, 0], axis=0).max() < 1e-6
