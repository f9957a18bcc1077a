"""Recipes are valid for every method, and the paper's has the paper's numbers."""

import json
from pathlib import Path

import pytest
import torch
from lab.tests.align.tuning_fakes import book, dpo, grpo, policy, ppo, training, wants_threes
from lab.tests.training.test_processes import launch
from pydantic import ValidationError
from tests.models.generator.tiny import generator

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.probe import Probe
from echoavatar_lab.align.rollouts import GrpoTask, PpoTask
from echoavatar_lab.align.start import tune
from echoavatar_lab.align.trainer import NO_CONTEXT, AlignTraining, RunContext, recipe
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.training import Loop


@pytest.mark.parametrize("name", ["tiny", "rehearsal", "paper"])
@pytest.mark.parametrize("method", ["grpo", "dpo", "ppo"])
def test_every_recipe_fits_every_method(name, method):
    assert recipe(name, method).method == method


def test_the_papers_numbers():
    """Settings: batch 16, rate 6e-5, KL 0.01, 30 rollouts (PPO 1), DPO's beta 0.1, critic 1e-5."""
    grpo, ppo = recipe("paper", "grpo"), recipe("paper", "ppo")
    assert (grpo.batch, grpo.learning_rate, grpo.kl_weight, grpo.group) == (16, 6e-5, 0.01, 30)
    assert (grpo.credit, grpo.beta, grpo.length) == ("sequence", 0.1, 15)
    assert (ppo.group, ppo.critic_rate) == (1, 1e-5)


def test_a_group_of_one_is_refused():
    with pytest.raises(ValidationError, match="group must be at least 2"):
        AlignTraining(method="grpo", group=1)
    with pytest.raises(ValueError, match="no recipe 'huge'"):
        recipe("huge", "grpo")


def probed(kind=grpo, **changes):
    """A stage that is measured on four prompts."""
    probe = Probe(book().spread(4), wants_threes, group=2)
    return kind(context=RunContext(probe=probe, rewards={"threes": 1.0}), **changes)


def told(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("kind", [grpo, *(pytest.param(kind, marks=pytest.mark.slow) for kind in (ppo, dpo))])
def test_a_killed_run_resumes_to_the_same_weights_and_the_same_curve(kind, tmp_path):
    """Killed after step 6 with its last checkpoint at step 5, in the middle of a batch's two epochs."""
    sizes = {"steps": 8, "save_every": 5, "evaluate_every": 4, "epochs": 2, "kl_weight": 0.01}
    tune(probed(kind, **sizes), tmp_path / "whole")

    class KilledError(Exception):
        pass

    def kill(done: int, total: int) -> None:
        if done == 6:
            raise KilledError

    with pytest.raises(KilledError):
        tune(probed(kind, **sizes), tmp_path / "cut", progress=kill)
    tune(probed(kind, **sizes), tmp_path / "cut")
    whole, again = (Generator.load(tmp_path / name).state_dict() for name in ("whole", "cut"))
    for name, value in whole.items():
        assert torch.equal(value, again[name]), name
    curves = []
    for name in ("whole", "cut"):
        lines = told(tmp_path / name)
        for line in lines:
            line.pop("seconds", None)
            line.get("held_out", {}).pop("seconds", None)
        curves.append(lines)
    assert curves[0] == curves[1]
    assert [line["step"] for line in curves[0] if "loss" in line] == [1, 2, 3, 4, 5, 6, 7, 8]
    assert [line["step"] for line in curves[0] if "held_out" in line] == [0, 4, 8]
    tune(probed(kind, **sizes), tmp_path / "whole")  # done: nothing is told twice
    assert len(told(tmp_path / "whole")) == len(curves[0])
    tune(probed(kind, **sizes | {"steps": 9}), tmp_path / "whole")  # steps may be added
    assert told(tmp_path / "whole")[-1]["step"] == 9


def test_accumulation_changes_only_rounding():
    found = []
    for pieces in (1, 2):
        loop = Loop(grpo(accumulation=pieces, epochs=2))
        found.append([loop.advance(), loop.advance()])
    for one, two in zip(*found, strict=True):
        assert one["reward"] == pytest.approx(two["reward"])
        assert one["loss"] == pytest.approx(two["loss"], abs=1e-6)
        assert one["gradient"] == pytest.approx(two["gradient"], rel=1e-5)


@pytest.mark.parametrize("method", ["grpo", "ppo"])
def test_a_policy_of_the_depth_order_is_tuned_like_any(method):
    kind = {"grpo": GrpoTask, "ppo": PpoTask}[method]
    model, settings = policy("depth"), training(method, epochs=2, kl_weight=0.01)
    loop = Loop(kind(model, policy("depth"), settings, wants_threes, NO_CONTEXT, book=book()))
    steps = [loop.advance() for _ in range(12)]
    assert sum(step["reward"] for step in steps[-4:]) > sum(step["reward"] for step in steps[:4])


SHARED = """
import json, sys
from lab.tests.align.test_trainer import curves
from echoavatar_lab.training.processes import processes_here

print(json.dumps(curves(processes_here())))
"""


def curves(processes=None) -> dict[str, list[list[float]]]:
    """Reward, loss and gradient of two steps of each method."""
    found = {}
    for kind in (grpo, ppo, dpo):
        loop = Loop(kind(epochs=2, kl_weight=0.01, batch=4, group=4), processes)
        steps = [loop.advance() for _ in range(2)]
        found[kind.__name__] = [[one.get("reward", 0.0), one["loss"], one["gradient"]] for one in steps]
    return found


@pytest.mark.slow
def test_two_processes_take_the_steps_of_one():
    """Each answers half of the prompts; the same rewards, losses and gradients as one process with all of them."""
    pytest.importorskip("accelerate")
    expected = curves()
    for out in launch(SHARED):
        found = json.loads(out.splitlines()[-1])
        for name, steps in expected.items():
            torch.testing.assert_close(
                torch.tensor(found[name]), torch.tensor(steps), rtol=1e-4, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}"
            )


def test_divergence_stops_the_run_at_the_last_checkpoint(tmp_path):
    assert "over kl_stop 0.05" in tune(grpo(steps=60, save_every=1, kl_stop=0.05), tmp_path)
    lines = told(tmp_path)
    assert "over kl_stop" in lines[-1]["stopped"]
    assert lines[-1]["step"] < 30
    kept = Generator.load(tmp_path).state_dict()
    assert "over kl_stop 0.05" in tune(grpo(steps=60, save_every=1, kl_stop=0.05), tmp_path)  # does not go on
    assert told(tmp_path)[-1] == lines[-1]
    assert all(torch.equal(value, kept[name]) for name, value in Generator.load(tmp_path).state_dict().items())
    with pytest.raises(CheckpointError, match="before the first checkpoint; use a smaller learning rate"):
        tune(grpo(steps=60, kl_stop=0.05), tmp_path / "never")


@pytest.mark.slow
def test_the_divergence_holds_the_policy_back():
    """The same steps with a heavy price on divergence end nearer to the reference."""
    far, near = ([Loop.advance(loop) for _ in range(12)][-1] for loop in (Loop(grpo()), Loop(grpo(kl_weight=5.0))))
    assert near["kl"] < 0.5 * far["kl"]
    assert far["kl"] > 0.02


def test_the_reference_and_exemplar_control_do_not_move():
    models = generator(exemplar=True), generator(exemplar=True)
    one = GrpoTask(*models, training("grpo"), wants_threes, book=book())
    before = {name: value.clone() for name, value in one.reference.generator.state_dict().items()}
    control = {n: v.clone() for n, v in one.generator.state_dict().items() if n.startswith("exemplar")}
    first = {n: v.clone() for n, v in one.generator.state_dict().items()}
    Loop(one).advance()
    assert control
    assert all(torch.equal(v, before[n]) for n, v in one.reference.generator.state_dict().items())
    assert all(torch.equal(v, control[n]) for n, v in one.generator.state_dict().items() if n in control)
    assert not all(torch.equal(v, first[n]) for n, v in one.generator.state_dict().items())


def test_resuming_with_other_settings_is_refused(tmp_path):
    layout = compact_layout(audio_codes=16, motion_layers=2, motion_codes=4)
    other, named = generator(layout=layout), RunContext(reference_name="old.gen")
    with pytest.raises(CheckpointError, match="reference old.gen has another vocabulary"):
        GrpoTask(policy(), other, training("grpo"), wants_threes, named, book=book())
    tune(probed(steps=1), tmp_path)
    with pytest.raises(CheckpointError, match="another training config: learning_rate was 0.03, is 0.001"):
        tune(probed(steps=1, learning_rate=1e-3), tmp_path)
    with pytest.raises(CheckpointError, match="another origin config: rewards was"):
        tune(grpo(steps=1), tmp_path)
    rewards = RunContext(rewards={"threes": 1.0})
    differs = GrpoTask(policy(), generator(seed=5), training("grpo", steps=1), wants_threes, rewards, book=book())
    with pytest.raises(CheckpointError, match="another origin config: reference was"):
        tune(differs, tmp_path)
