"""Statistics of many bodies at once are those of `evaluate BUNDLE alive`."""

import numpy as np
import torch

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.align.tuning.movement import NAMES, hands_still, liveliness, of_common_height
from echoavatar_lab.evaluation.metrics import liveliness as one_by_one

FRAMES = 240
REST = HUMANOID.rest_positions[[HUMANOID.index(name) for name in one_by_one.POINTS]]


def test_statistics_are_those_of_the_evaluation() -> None:
    random = np.random.default_rng(2)
    paths = 0.02 * random.standard_normal((3, FRAMES, len(REST), 3)).cumsum(1) + REST.numpy()
    points, stands = of_common_height(torch.from_numpy(paths).float())
    found = liveliness(points).numpy()
    assert stands.all()
    for row, path in enumerate(paths):
        wanted = one_by_one.liveliness(one_by_one.of_common_height(path), 30.0)
        assert list(wanted) == list(NAMES)
        np.testing.assert_allclose(found[row], list(wanted.values()), rtol=2e-2, atol=2e-3)


def test_still_frames_are_those_of_the_statistic() -> None:
    paths = REST[None, None].repeat(1, FRAMES, 1, 1)
    paths[:, FRAMES // 2 :, one_by_one.POINTS.index("leftHand"), 0] += torch.linspace(0, 2, FRAMES // 2)
    still = hands_still(paths)
    assert still.shape == (1, FRAMES)
    assert still[0, : FRAMES // 2 - 5].all()
    assert not still[0, FRAMES // 2 + 5 :].any()
    assert still[:, 1:].float().mean() == liveliness(paths)[0, NAMES.index("hands_still")]


def test_a_body_upside_down_does_not_stand() -> None:
    both = torch.stack([REST, REST * torch.tensor([1.0, -1.0, 1.0])])[:, None].expand(-1, 40, -1, -1)
    assert of_common_height(both)[1].tolist() == [True, False]
