"""What is kept of a batch of continuations, and what of it a checkpoint holds."""

import pytest
import torch
from lab.tests.align.tuning_fakes import book, grpo, ppo, wants_threes

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.trainer import RunContext
from echoavatar_lab.training import Loop
from echoavatar_lab.training.task import tensors_in


@pytest.mark.parametrize("kind", [grpo, ppo])
def test_a_batch_is_drawn_once_for_all_its_epochs_and_survives_a_checkpoint_between_them(kind):
    one = kind(epochs=2)
    first = one.draw(4)
    kept = dict(one.state())
    assert one.draw(5) is first
    assert one.state() == {}  # the next step draws anew
    other = kind(epochs=2)
    other.load_state(kept)
    for own, theirs in zip(tensors_in(first), tensors_in(other.draw(5)), strict=True):
        assert torch.equal(own, theirs)
    assert other.logged_means(first).keys() == one.logged_means(first).keys() == {"reward", "rewards.threes", "spread"}


def test_continuations_may_come_from_a_backend():
    """The backend gets the policy, so that it can copy its weights; this one returns the policy's codes plus one."""
    asked = []

    def backend(own):
        def rollout(prompts, group, seeds):
            asked.append(len(seeds))
            return (own.rollout(prompts, group, seeds) + 1) % 8

        return rollout

    one, plain = grpo(context=RunContext(rollouts=backend)), grpo()
    assert torch.equal(one.draw(3).codes, (plain.draw(3).codes + 1) % 8)
    assert asked == [one.config.batch * one.config.group]
    Loop(one).advance()


def test_one_epoch_of_grpo_stores_no_old_scores():
    assert grpo(epochs=1).draw(0).old is None
    assert grpo(epochs=2).draw(0).old is not None
    assert ppo(epochs=1).draw(0).values is not None


def test_the_logged_values_are_the_judged_ones():
    one = grpo()
    made = one.draw(0)
    prompts = one._book.draw(0, one.config.batch)
    wanted = wants_threes(prompts, made.codes).total
    told = one.logged_means(made)
    assert float(told["reward"]) == pytest.approx(wanted.mean(), abs=1e-6)
    spread = wanted.reshape(one.config.batch, -1).std(1).mean()
    assert float(told["spread"]) == pytest.approx(spread, abs=1e-6)


def test_a_past_of_its_own_is_the_policys_and_is_what_continuations_follow():
    plain, own = (grpo(prompts=book(past=2), past=2, own_past=share) for share in (0, 1))
    one, other = plain.draw(0), own.draw(0)
    assert torch.equal(one.prompts.audio, other.prompts.audio)
    assert torch.equal(one.prompts.past[:, :2], other.prompts.past[:, :2])  # a chunk of true motion
    assert not torch.equal(one.prompts.past[:, 2:], other.prompts.past[:, 2:])
    rows = other.prompts.past.view(own.config.batch, own.config.group, *other.prompts.past.shape[1:])
    assert (rows == rows[:, :1]).all()  # one past for all continuations of a prompt
    again = grpo(prompts=book(past=2), past=2, own_past=1).draw(0)
    assert torch.equal(again.prompts.past, other.prompts.past)
    assert torch.equal(again.codes, other.codes)


def test_more_own_past_than_past_is_refused():
    with pytest.raises(ValueError, match=r"own_past \(2\) chunks are the last of the past \(1\)"):
        grpo(own_past=2)


@pytest.mark.parametrize("credit", [pytest.param("sequence", marks=pytest.mark.slow), "to_go"])
def test_a_policy_learns_the_wanted_code(credit):
    """An eighth of the codes to begin with, over nine tenths after 320 continuations."""
    loop = Loop(grpo(credit=credit))
    rewards = [loop.advance()["reward"] for _ in range(20)]
    assert rewards[0] < 0.3
    assert rewards[-1] > 0.9


@pytest.mark.slow
def test_several_steps_on_the_same_continuations_learn_more_from_them():
    curves = []
    for epochs in (1, 3):
        loop = Loop(grpo(epochs=epochs, learning_rate=1e-2))
        curves.append([loop.advance()["reward"] for _ in range(8 * epochs)][::epochs])
    assert curves[0][0] == curves[1][0]
    assert sum(curves[1]) > sum(curves[0]) + 0.3


def test_rewards_reach_only_the_layers_that_they_are_credited_to():
    advantages = torch.tensor([[1.0, -2.0]])
    task = grpo(layers=1)
    layers, parts = task.policy.layout.motion_layers, task.policy.layout.parts
    credited = task.credited(advantages).view(1, 2, parts, layers)
    torch.testing.assert_close(credited[..., 0], advantages[..., None].expand(1, 2, parts))
    assert layers > 1
    assert (credited[..., 1:] == 0).all()
    assert (grpo().credited(advantages) == advantages[..., None]).all()


def test_more_layers_than_the_generator_has_are_refused():
    with pytest.raises(CheckpointError, match="layers is 9, the generator has"):
        grpo(layers=9)


@pytest.mark.slow
def test_policy_and_critic_learn_the_wanted_code():
    """Returns come near 1 and 0.5 at the two tokens: a critic that still said 0 would be off by 0.31."""
    sizes = {"group": 1, "batch": 16, "discount": 1.0, "epochs": 2, "learning_rate": 2e-2, "critic_rate": 5e-2}
    loop = Loop(ppo(**sizes))
    told = [loop.advance() for _ in range(36)]
    assert told[0]["reward"] < 0.3
    assert told[-1]["reward"] > 0.9
    assert told[-1]["value"] < 0.1


def test_the_critic_has_a_rate_of_its_own():
    one = ppo(learning_rate=1e-2, critic_rate=1e-3, warmup=0)
    loop = Loop(one)
    loop.advance()
    assert [group["lr"] for optimiser in loop.optimisers for group in optimiser.param_groups] == pytest.approx(
        [1e-2] * (len(loop.optimisers[0].param_groups)) + [1e-3] * len(loop.optimisers[1].param_groups)
    )
