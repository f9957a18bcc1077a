"""What is kept of a batch of continuations, and what of it a checkpoint holds."""

import pytest
import torch
from lab.tests.align.tuning_fakes import book, grpo, ppo, wants_threes

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
