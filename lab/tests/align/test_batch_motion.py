"""What many continuations at once measure is what the rewards and the evaluation measure of one."""

import numpy as np
import pytest
import torch
from lab.tests.align.moving_bodies import LEAD, dips, reference_statistics, scene

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.align.batch_motion import hands_still, liveliness, of_common_height, timing
from echoavatar_lab.align.decoded_motion import DecodedMotion
from echoavatar_lab.align.rewards import beat_alignment, stress_alignment
from echoavatar_lab.evaluation.metrics import liveliness as one_by_one

FRAMES = 240


@pytest.fixture
def bodies() -> list[DecodedMotion]:
    """Bodies that brake at times of their own, some beside their beats, one without any."""
    random, made = np.random.default_rng(1), []
    for level in (0.3, 0.5, 0.9):
        events = np.sort(random.uniform(0.3, 7.5, 9))
        heard = np.sort(random.uniform(0.3, 7.5, 7 if level < 0.9 else 1))
        speed = dips(events, frames=FRAMES, level=level) * random.uniform(0.9, 1.1, FRAMES + LEAD)
        made.append(scene(speed, beats=heard, stresses=heard - 0.1, jitter=0.002))
    return made


def events(bodies: list[DecodedMotion], name: str) -> torch.Tensor:
    table = np.full((len(bodies), 7), np.nan, np.float32)
    for row, body in zip(table, bodies, strict=True):
        own = getattr(body, name)
        row[: len(own)] = own
    return torch.from_numpy(table)


def test_hits_are_those_of_the_rewards(bodies: list[DecodedMotion]) -> None:
    positions = torch.from_numpy(np.stack([body.positions for body in bodies])).float()
    beats, stresses = timing(HUMANOID, positions, LEAD, events(bodies, "beats"), events(bodies, "stresses"))
    own = reference_statistics()
    for row, body in enumerate(bodies):
        assert float(beats[row].sum()) == pytest.approx(beat_alignment(body, own).sum(), abs=5e-3)
        assert float(stresses[row].sum()) == pytest.approx(stress_alignment(body, own).sum(), abs=5e-3)
    assert beats[:2].sum(1).abs().min() > 0.01  # something was hit or missed
    assert not beats[2].any()  # one event has no chance level


REST = torch.from_numpy(HUMANOID.rest_positions[[HUMANOID.index(name) for name in one_by_one.POINTS]])


def test_statistics_are_those_of_the_evaluation() -> None:
    random = np.random.default_rng(2)
    paths = 0.02 * random.standard_normal((3, FRAMES, len(REST), 3)).cumsum(1) + REST.numpy()
    points, stands = of_common_height(torch.from_numpy(paths).float())
    found = liveliness(points).numpy()
    assert stands.all()
    for row, path in enumerate(paths):
        wanted = one_by_one.liveliness(one_by_one.of_common_height(path), 30.0)
        assert list(wanted) == list(one_by_one.STATISTICS)
        np.testing.assert_allclose(found[row], list(wanted.values()), rtol=2e-2, atol=2e-3)


def test_still_frames_are_those_of_the_statistic() -> None:
    paths = REST[None, None].repeat(1, FRAMES, 1, 1)
    paths[:, FRAMES // 2 :, one_by_one.POINTS.index("leftHand"), 0] += torch.linspace(0, 2, FRAMES // 2)
    still = hands_still(paths)
    assert still.shape == (1, FRAMES)
    assert still[0, : FRAMES // 2 - 5].all()
    assert not still[0, FRAMES // 2 + 5 :].any()
    assert still[:, 1:].float().mean() == liveliness(paths)[0, list(one_by_one.STATISTICS).index("hands_still")]


def test_a_body_upside_down_does_not_stand() -> None:
    both = torch.stack([REST, REST * torch.tensor([1.0, -1.0, 1.0])])[:, None].expand(-1, 40, -1, -1)
    assert of_common_height(both)[1].tolist() == [True, False]
