"""Exact resume, early stop, refusals."""

import json

import pytest
import torch
from tests.align.tuning import book, clips, policy, training, wants_threes
from tests.generator.tiny import generator

from echoavatar.align.grpo import GrpoTrainer
from echoavatar.align.ppo import PpoTrainer
from echoavatar.align.prompts import PromptBook
from echoavatar.align.trainer import run
from echoavatar.errors import CheckpointError


def trainer(kind=GrpoTrainer, **changes):
    method = "grpo" if kind is GrpoTrainer else "ppo"
    return kind(policy(), policy(), training(method, **changes), wants_threes, book=book())


@pytest.mark.parametrize("kind", [GrpoTrainer, pytest.param(PpoTrainer, marks=pytest.mark.slow)])
def test_a_killed_run_resumes_to_the_same_weights_and_the_same_curve(kind, tmp_path):
    """Killed after step 5 with its last checkpoint at step 4: steps 4 and 5 are told again, all bits alike."""
    sizes = {"steps": 6, "save_every": 2, "probe_every": 3, "epochs": 2, "kl_weight": 0.01}
    whole = run(trainer(kind, **sizes), tmp_path / "whole", held_out=book(), card={})

    class KilledError(Exception):
        pass

    def kill(done: int, total: int) -> None:
        if done == 5:
            raise KilledError

    killed = trainer(kind, **sizes)
    with pytest.raises(KilledError):
        run(killed, tmp_path / "cut", held_out=book(), card={}, progress=kill)
    again = run(trainer(kind, **sizes), tmp_path / "cut", held_out=book(), card={})
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name
    curves = []
    for name in ("whole", "cut"):
        lines = [json.loads(line) for line in (tmp_path / name / "metrics.jsonl").read_text().splitlines()]
        curves.append([{key: line[key] for key in line if key != "seconds"} for line in lines])
    assert curves[0] == curves[1]
    assert [line["step"] for line in curves[0] if "step" in line] == [0, 1, 2, 3, 4, 5]
    assert [line["probe"] for line in curves[0] if "probe" in line] == [0, 3, 6]


def test_how_many_fit_into_memory_changes_nothing_but_rounding():
    first, second = trainer(micro=64), trainer(micro=5)
    one, two = first.step(), second.step()
    assert one["reward"] == two["reward"]
    assert one["loss"] == pytest.approx(two["loss"], abs=1e-6)
    for a, b in zip(first.trained(), second.trained(), strict=True):
        torch.testing.assert_close(a.grad if a.grad is not None else a, b.grad if b.grad is not None else b)


def test_a_divergence_that_runs_away_stops_the_run_at_the_last_checkpoint(tmp_path):
    run(trainer(steps=60, save_every=1, kl_stop=0.05), tmp_path, held_out=None, card={})
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert "over kl_stop" in lines[-1]["stopped"]
    assert lines[-1]["step"] < 30
    calm = trainer(steps=60, save_every=1, kl_stop=0.05)
    calm.resume(tmp_path)
    assert calm.next_step == lines[-1]["step"]
    assert calm.stopped  # another call does not go on


@pytest.mark.slow
def test_the_divergence_holds_the_policy_back():
    """The same steps with a heavy price on divergence end nearer to the reference."""
    far, near = trainer(), trainer(kl_weight=5.0)
    for one in (far, near):
        for _ in range(12):
            told = one.step()
        one.told = told
    assert near.told["kl"] < 0.5 * far.told["kl"]
    assert far.told["kl"] > 0.02


def test_the_reference_and_exemplar_control_do_not_move():
    one = GrpoTrainer(
        generator(exemplar=True), generator(exemplar=True), training("grpo"), wants_threes, book=book()
    )
    before = {name: value.clone() for name, value in one.reference.generator.state_dict().items()}
    control = {n: v.clone() for n, v in one.generator.state_dict().items() if n.startswith("exemplar")}
    one.step()
    assert all(torch.equal(v, before[n]) for n, v in one.reference.generator.state_dict().items())
    assert all(torch.equal(v, control[n]) for n, v in one.generator.state_dict().items() if n in control)


def test_refusals_name_what_is_wrong(tmp_path):
    layout = type(policy().config.layout).compact(audio_codes=16, motion_layers=2, motion_codes=4)
    other = generator(layout=layout)
    with pytest.raises(CheckpointError, match="reference old.gen is of another vocabulary"):
        GrpoTrainer(policy(), other, training("grpo"), wants_threes, book=book(), reference_name="old.gen")
    run(trainer(steps=1), tmp_path, held_out=None, card={})
    differs = trainer(steps=1, learning_rate=1e-3)
    with pytest.raises(CheckpointError, match="another training"):
        differs.resume(tmp_path)
    differs = GrpoTrainer(policy(), generator(seed=5), training("grpo", steps=1), wants_threes, book=book())
    with pytest.raises(CheckpointError, match="another reference"):
        differs.resume(tmp_path)


def test_probes_do_not_depend_on_the_step():
    one = trainer()
    prompts = PromptBook(clips(), past=1, length=1).spread(4)
    first = one.probe(prompts)
    one.next_step = 7
    second = one.probe(prompts)
    assert first["rewards"] == second["rewards"]
    assert first["kl"] == 0
