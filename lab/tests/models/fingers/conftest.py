"""A tiny finger model, trained for some seconds."""

from pathlib import Path

import pytest
from lab.tests.models.fingers.moving import TINY, waving

from echoavatar_lab.models.fingers.clips import finger_clip
from echoavatar_lab.models.fingers.model import FingerModel
from echoavatar_lab.models.fingers.train import FingerTask, FingerTraining
from echoavatar_lab.training import train


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a model that has learned that hands close as arms rise."""
    folder = tmp_path_factory.mktemp("fingers")
    clips = [finger_clip(waving(seed=seed)) for seed in range(8)]
    training = FingerTraining(
        steps=200,
        batch=8,
        warmup=10,
        learning_rate=5e-3,
        save_every=1000,
        recorded=0.0,
        body_noise=0.02,
        body_offset=0.0,
    )
    train(FingerTask(TINY, training, clips, card={"data": "waving bodies"}), folder)
    return folder


@pytest.fixture(scope="session")
def model(trained: Path) -> FingerModel:
    """The trained model."""
    return FingerModel.load(trained)
