"""Hits that are found in batches are those of the rewards."""

import numpy as np
import pytest
import torch
from lab.tests.align.moving_bodies import LEAD, dips, reference_statistics, scene

from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.align.decoded_motion import DecodedMotion
from echoavatar_lab.align.rewards import beat_alignment, stress_alignment
from echoavatar_lab.align.tuning.timing import timing

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
