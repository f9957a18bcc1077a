"""Losses run where their batches and modules are: on the meta device any tensor that was left behind is an error."""

import pytest
import torch
from lab.tests.models.generator.test_train import clips, config, settings
from tests.models.face.tiny import CONFIG as FACE
from tests.models.face.tiny import clip

from echoavatar.models.face import MelConfig
from echoavatar_lab.models.face.train import FaceTask, FaceTraining, paper_face
from echoavatar_lab.models.generator.train import GeneratorTask
from echoavatar_lab.training import TrainingTask
from echoavatar_lab.training.task import row_count, take_rows

META = torch.device("meta")


def descend_elsewhere(stage: TrainingTask) -> None:
    whole = stage.draw(0)
    batch = take_rows(whole, slice(0, row_count(whole)), META)
    for module in stage.modules.values():
        module.to(META)
    loss = stage.loss(batch, 0).total
    loss.backward()
    assert loss.device == META


@pytest.mark.parametrize("sizes", [FACE, paper_face(encoder=MelConfig())], ids=["ours", "paper"])
def test_the_face(sizes) -> None:
    descend_elsewhere(FaceTask(sizes, FaceTraining(batch=2, frames=16, tempo=False), [clip()]))


@pytest.mark.parametrize("sequence", ["interleaved", "prefix", "depth"])
@pytest.mark.parametrize("objective", ["motion", "streams"])
def test_the_generator(sequence: str, objective: str) -> None:
    lesson = settings(objective=objective, exemplar=0.5, cue_weight=0.1)
    descend_elsewhere(GeneratorTask(config(sequence=sequence, exemplar=True), lesson, clips()))
