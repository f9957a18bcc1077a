import math

import pytest
import torch
from lab.tests.models.generator.test_train import clips, config, settings
from lab.tests.training.line import CONFIG, Line, weights
from torch import nn

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar_lab.checkpoint import read_weights
from echoavatar_lab.models.generator.train import GeneratorTask
from echoavatar_lab.training import Loop, Loss
from echoavatar_lab.training.loop import AveragedWeights, Recording
from echoavatar_lab.training.processes import Processes


def test_the_average_follows_slowly_and_knows_only_what_learns():
    """A weight that jumps from 0 to 1: the first steps go 9/10, 9/11 of what is left, later ones 1 - decay."""
    model = nn.Linear(1, 1)
    model.bias.requires_grad_(False)
    nn.init.zeros_(model.weight)
    average = AveragedWeights({"m": model}, 0.99)
    assert list(average.values) == ["m.weight"]
    nn.init.ones_(model.weight)
    average.update(0)
    torch.testing.assert_close(average.values["m.weight"], torch.tensor([[0.9]]))
    nn.init.zeros_(model.weight)
    average.update(10**6)
    torch.testing.assert_close(average.values["m.weight"], torch.tensor([[0.9 * 0.99]]))


def test_modules_hold_the_average_inside_the_context_only():
    model = nn.Linear(2, 2)
    average, own = AveragedWeights({"m": model}, 0.99), model.weight.detach().clone()
    average.values["m.weight"] += 1
    with average.applied():
        torch.testing.assert_close(model.weight, own + 1)
    torch.testing.assert_close(model.weight, own)


def run(loop, steps):
    return [loop.advance() for _ in range(steps)]


@pytest.mark.parametrize("average", [0.0, 0.9])
def test_a_resumed_run_is_the_same_run_to_the_bit(tmp_path, average):
    """Also what it draws from torch's global generator, its averages and the stage's own state."""
    config = CONFIG.model_copy(update={"average": average})
    torch.manual_seed(5)
    whole = Loop(Line(config))
    expected = run(whole, 10)
    torch.manual_seed(5)
    first = Loop(Line(config))
    run(first, 4)
    first.save(tmp_path)
    torch.manual_seed(99)
    second = Loop(Line(config))
    assert second.resume(tmp_path)
    assert run(second, 6) == expected[4:]
    assert torch.equal(weights(second.stage), weights(whole.stage))
    assert second.stage.seen == 10
    assert second.stage.modules["mean"].value == whole.stage.modules["mean"].value != 0
    if average:
        assert all(torch.equal(v, whole.average.values[k]) for k, v in second.average.values.items())


def test_pieces_share_one_trajectory():
    """Eight rows at once, or one after the other: the same sums in another order."""
    losses = []
    for pieces in (1, 8):
        torch.manual_seed(0)
        loop = Loop(Line(CONFIG.model_copy(update={"accumulation": pieces})))
        losses.append([(told["loss"], told["gradient"]) for told in run(loop, 10)])
    torch.testing.assert_close(torch.tensor(losses[0]), torch.tensor(losses[1]), rtol=1e-5, atol=1e-6)


def test_a_metric_that_is_no_number_in_a_piece_is_averaged_over_the_others(monkeypatch):
    def loss(self, batch, step):
        return Loss(self.modules["layers"][0].weight.sum(), {"some": batch[0].sum(), "none": torch.tensor(math.nan)})

    rows = torch.tensor([[1.0], [math.nan], [3.0], [math.nan]])
    monkeypatch.setattr(Line, "draw", lambda self, step: (rows, rows))
    monkeypatch.setattr(Line, "loss", loss)
    monkeypatch.setattr(Line, "after", lambda self, step, gather: None)
    told = Loop(Line(CONFIG.model_copy(update={"batch": 4, "accumulation": 4}))).advance()
    assert told["some"] == 2
    assert "none" not in told


def test_averaged_weights_are_shown_and_the_others_trained_on(tmp_path):
    """After one step the average has gone 1 - 1/10 of the way, and is what the checkpoint shows."""
    loop = Loop(Line(CONFIG.model_copy(update={"average": 0.999})))
    before = weights(loop.stage)
    run(loop, 1)
    after = weights(loop.stage)
    loop.save(tmp_path)
    saved = read_weights(tmp_path)
    shown = torch.cat([saved[key].flatten() for key in loop.stage.modules["layers"].state_dict()])
    torch.testing.assert_close(shown, before + 0.9 * (after - before))
    assert torch.equal(weights(loop.stage), after)


def test_another_schedule_or_size_is_refused_by_name(tmp_path):
    Loop(Line()).save(tmp_path)
    with pytest.raises(CheckpointError, match="seed was 0, is 1"):
        Loop(Line(CONFIG.model_copy(update={"seed": 1}))).resume(tmp_path)
    with pytest.raises(CheckpointError, match=r"layers.0.weight is \(2, 1\), wanted \(3, 1\)"):
        Loop(Line(hidden=3)).resume(tmp_path)
    assert Loop(Line(CONFIG.model_copy(update={"accumulation": 2}))).resume(tmp_path)
    assert not Loop(Line()).resume(tmp_path / "nothing")


def test_a_batch_that_cannot_be_shared_is_refused():
    with pytest.raises(EchoAvatarError, match=r"batch \(8\) must be a multiple .*1 x 3"):
        Loop(Line(CONFIG.model_copy(update={"accumulation": 3})))


def test_a_loss_that_is_no_number_ends_the_run():
    loop = Loop(Line())
    with torch.no_grad():
        next(loop.stage.modules["layers"].parameters()).fill_(float("nan"))
    with pytest.raises(EchoAvatarError, match="the loss is nan at step 1"):
        loop.advance()


def test_bfloat16_products_are_close_and_not_the_same(monkeypatch):
    monkeypatch.setattr("echoavatar_lab.training.loop.multiplies_bfloat16", lambda device: True)
    rough, fine = (Loop(Line(CONFIG.model_copy(update={"autocast": on}))) for on in (True, False))
    torch.manual_seed(0)
    a = rough.advance()["loss"]
    torch.manual_seed(0)
    b = fine.advance()["loss"]
    assert a != b
    assert a == pytest.approx(b, rel=0.02)


def test_a_processor_that_is_slow_at_bfloat16_is_not_asked_for_it(monkeypatch):
    monkeypatch.setattr("echoavatar_lab.training.loop.multiplies_bfloat16", lambda device: False)
    losses = []
    for on in (True, False):
        loop = Loop(Line(CONFIG.model_copy(update={"autocast": on})))
        torch.manual_seed(0)
        losses.append(loop.advance()["loss"])
    assert losses[0] == losses[1]


def test_the_clock_counts_where_it_is_part_of_the_schedule():
    loop = Loop(Line(CONFIG.model_copy(update={"minutes": 1.0})))
    loop.seconds = 45.0
    assert loop.done() == 0.75
    loop.step = 12
    assert loop.done() == 1


def test_groups_may_have_a_rate_relative_to_the_steps_and_the_stage_knows_who_shares_the_run():
    class Slower(Line):
        def optimisers(self):
            first, second = self.modules["layers"]
            groups = [{"params": first.parameters()}, {"params": second.parameters(), "relative": 0.1}]
            return [torch.optim.AdamW(groups)]

    loop = Loop(Slower())
    told = loop.advance()
    assert [group["lr"] for group in loop.optimisers[0].param_groups] == pytest.approx(
        [told["rate"], 0.1 * told["rate"]]
    )
    assert loop.stage.processes is loop.processes


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
