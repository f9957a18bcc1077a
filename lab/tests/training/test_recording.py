"""Passes that are recorded and replayed."""

import pytest
import torch
from lab.tests.models.generator.test_train import clips, config, settings
from torch import nn

from echoavatar_lab.models.generator.train import GeneratorTask
from echoavatar_lab.training import Loop
from echoavatar_lab.training.processes import Processes
from echoavatar_lab.training.recording import Recording

CPU = torch.device("cpu")


def test_a_replay_reads_the_new_batch_where_the_first_one_lay():
    seen = []

    def run(batch):
        seen.append((batch[0].data_ptr(), batch[0].sum().item()))
        return {"loss": batch[0].sum()}

    recording = Recording(run, CPU, capture=lambda run: run)
    first = (torch.ones(2, 3), "a name")
    values = [recording(batch)["loss"].item() for batch in (first, (torch.full((2, 3), 2.0), "a name"))]
    assert values == [6, 12]
    assert seen[0][0] == seen[1][0]


def test_a_batch_of_another_shape_is_refused():
    recording = Recording(lambda batch: {"loss": batch.sum()}, CPU, capture=lambda run: run)
    recording(torch.ones(2, 3))
    with pytest.raises(RuntimeError, match="size"):
        recording(torch.ones(4, 5))


def test_only_a_gpu_records():
    stage = GeneratorTask(config(sequence="depth"), settings(), clips())
    assert stage.is_recordable
    assert Loop(stage)._recording is None


@pytest.mark.gpu
def test_a_recorded_run_has_the_losses_of_one_that_is_not():
    told = []
    for is_recorded in (True, False):
        stage = GeneratorTask(config(sequence="depth", exemplar=True), settings(exemplar=0.5, cue_weight=0.1), clips())
        stage.is_recordable = is_recorded
        loop = Loop(stage, Processes("cuda"))
        told.append([[values["loss"], values["gradient"]] for values in (loop.advance() for _ in range(5))])
        weights = nn.utils.parameters_to_vector(stage.generator.parameters())
        assert bool(weights.isfinite().all())
    torch.testing.assert_close(torch.tensor(told[0]), torch.tensor(told[1]), rtol=1e-3, atol=1e-4)
