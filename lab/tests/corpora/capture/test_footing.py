from dataclasses import replace

import numpy as np

from echoavatar_lab.corpora.capture.footing import stepping
from echoavatar_lab.corpora.controls import ANKLE_HEIGHT, Controls, minimum_jerk, neutral


def shuffling(lift: float) -> Controls:
    """The left foot moves 20 cm outwards between 1.0 and 1.5 s; the right one drifts by a centimetre all the time."""
    base = neutral(90)
    place = base.foot_position.copy()
    share = minimum_jerk((np.arange(90) - 30) / 15)
    place[:, 0, 0] += 0.2 * share
    place[:, 0, 1] += lift * 4 * share * (1 - share)
    place[:, 1, 2] += np.linspace(0, 0.01, 90, dtype=np.float32)
    return replace(base, foot_position=place)


def test_a_slide_becomes_a_step():
    feet = stepping(shuffling(0.0)).foot_position
    speed = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * 30
    height = feet[..., 1] - ANKLE_HEIGHT
    assert height.max() > 0.04
    assert speed[np.maximum(height[1:], height[:-1]) < 0.008].max() < 0.05
    np.testing.assert_allclose(feet[[0, -1], 0, 0], [0.105, 0.305], atol=2e-3)


def test_a_standing_foot_does_not_drift():
    feet = stepping(shuffling(0.08)).foot_position
    assert np.ptp(feet[:, 1], axis=0).max() < 1e-6
    assert feet[:, 0, 1].max() - ANKLE_HEIGHT > 0.075  # a true step keeps its height


def test_a_long_way_becomes_several_steps():
    base = neutral(120)
    place = base.foot_position.copy()
    place[20:100, 0, 2] += np.linspace(0, 0.5, 80, dtype=np.float32)
    place[100:, 0, 2] += 0.5
    feet = stepping(replace(base, foot_position=place)).foot_position[:, 0]
    landings = np.flatnonzero(np.diff((feet[:, 1] < ANKLE_HEIGHT + 1e-5).astype(int)) == 1)
    assert len(landings) >= 2
    assert abs(feet[-1, 2] - place[-1, 0, 2]) < 5e-3
