"""Losses against cases worked out by hand, against TRL, and by finite differences.

TRL is no dependency; the numbers marked TRL are what the functions `GRPOTrainer._compute_loss` (`loss_type="grpo"`) and
`DPOTrainer._compute_loss` (`loss_type="sigmoid"`) of its release 1.16.0 returned in double precision for the
log-probabilities beside them, with their gradients. Its PPO trainer is gone from that release.
"""

import math

import pytest
import torch

from echoavatar_lab.align.dpo import dpo_loss
from echoavatar_lab.align.policy import exact_kl
from echoavatar_lab.align.rollouts import (
    generalised_advantages,
    group_advantages,
    grpo_loss,
    ppo_loss,
    rewards_to_go,
    timed_advantages,
)
from echoavatar_lab.align.trainer import AlignTraining


def t(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def k3(policy: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
    """TRL's estimator of the divergence, by Schulman."""
    return (reference - policy).exp() - (reference - policy) - 1


def test_a_groups_advantages_are_its_z_scores():
    """Rewards 1, 2, 3: mean 2, spread (n - 1) 1, so -1, 0, 1 over 1.0001; a group all alike teaches nothing."""
    found = group_advantages(torch.stack([t(1, 2, 3), t(5, 5, 5)]))
    torch.testing.assert_close(found, torch.stack([t(-1, 0, 1) / 1.0001, t(0, 0, 0)]))
    assert torch.equal(group_advantages(t(1, 2)[:, None]), torch.zeros(2, 1, dtype=torch.float64))


def test_rewards_to_go_by_hand():
    """With discount 0.5: 3; 2 + 1.5; 1 + 1.75."""
    torch.testing.assert_close(rewards_to_go(t(1, 2, 3), 0.5), t(2.75, 3.5, 3))


def test_advantages_by_time_are_the_papers_when_all_reward_comes_at_the_end():
    """Discount 1 and a single number a continuation: the same for every code, (r - mu) / sigma up to n and n - 1."""
    whole, none = t(0.0, 1.0, 5.0)[None], torch.zeros(1, 3, 4, dtype=torch.float64)
    timed = timed_advantages(none, whole, 1.0)
    assert torch.equal(timed, timed[:, :, :1].expand_as(timed))
    torch.testing.assert_close(timed[:, :, 0], group_advantages(whole))
    at_the_end = none.clone()
    at_the_end[..., -1] = whole
    torch.testing.assert_close(timed_advantages(at_the_end, torch.zeros_like(whole), 1.0), timed)


def test_advantages_exclude_earlier_rewards():
    """Continuation 0 earns 1 at the first token, 1 at the last: after the first token only the second counts."""
    rewards = torch.zeros(1, 2, 3, dtype=torch.float64)
    rewards[0, 0, 0] = rewards[0, 1, 2] = 1
    found = timed_advantages(rewards, torch.zeros(1, 2, dtype=torch.float64), 1.0)[0]
    assert found[0, 0] == found[1, 0] == 0  # both still earn 1
    assert found[0, 1] == found[0, 2] == -found[1, 2] < 0


def test_exact_divergence_by_hand_and_as_the_mean_of_the_estimator():
    """(0.5, 0.5) against (0.9, 0.1): 0.5 ln(5/9) + 0.5 ln 5 = 0.5108; a third code is out of support."""
    support = torch.tensor([[True, True, False]])
    p = torch.log(t(0.5, 0.5, 0.0))[None]
    q = torch.log(t(0.9, 0.1, 0.0))[None]
    kl = exact_kl(p, q, support)
    assert kl.item() == pytest.approx(0.5 * math.log(5 / 9) + 0.5 * math.log(5))
    estimated = (p.exp() * k3(p, q).nan_to_num())[:, :2].sum()
    assert estimated.item() == pytest.approx(kl.item())


POLICY = [[-1.2, -0.3, -2.0, -0.7], [-0.5, -1.1, -0.9, -1.6], [-3.0, -0.2, -0.4, -1.0]]
OLD = [[-1.0, -0.5, -2.5, -0.7], [-0.6, -1.0, -0.4, -1.9], [-2.4, -0.3, -0.4, -1.3]]
REFERENCE = [[-1.1, -0.4, -2.2, -0.9], [-0.5, -1.4, -0.6, -1.5], [-2.9, -0.2, -0.6, -0.8]]
ADVANTAGES = [1.1, -0.3, -0.8]
TRL_CLIPPED = 1 / 3
TRL_GRPO = {
    (0.2, 0.04): (
        0.0015770819965344278,
        [
            [-0.07540088875906717, 0.00031720860654680175, 0.0006042308230733945, -0.09106243584359328],
            [0.027629272951891184, 0.023484874715293258, -0.001166196025253344, 0.03339590046248125],
            [-0.0003505697269188257, 0.07367806120504317, 0.06727089748974006, 0.08925257797786632],
        ],
    ),
    (0.1, 0.0): (
        0.028448341270151906,
        [
            [-0.07505031903214834, 0.0, 0.0, -0.09166666666666667],
            [0.027629272951891184, 0.022620935450898987, 0.0, 0.03374647018940007],
            [0.0, 0.07367806120504317, 0.06666666666666667, 0.08999058717173354],
        ],
    ),
}


@pytest.mark.parametrize(("clip", "weight"), TRL_GRPO)
def test_grpo_is_trls(clip, weight):
    """TRL 1.16.0: loss, gradient, share of clipped codes."""
    policy = torch.tensor(POLICY, dtype=torch.float64, requires_grad=True)
    old, reference = (torch.tensor(rows, dtype=torch.float64) for rows in (OLD, REFERENCE))
    told = grpo_loss(
        policy=policy,
        old=old,
        advantages=t(*ADVANTAGES)[:, None],
        kl=k3(policy, reference),
        clip=clip,
        kl_weight=weight,
    )
    told.loss.backward()
    loss, gradient = TRL_GRPO[clip, weight]
    assert told.loss.item() == pytest.approx(loss, rel=1e-12)
    torch.testing.assert_close(policy.grad, torch.tensor(gradient, dtype=torch.float64))
    assert told.clipped.item() == pytest.approx(TRL_CLIPPED)


@pytest.mark.parametrize(
    ("ratio", "advantage", "counts"),
    [(1.19, 1, True), (1.21, 1, False), (1.21, -1, True), (0.81, -1, True), (0.79, -1, False), (0.79, 1, True)],
)
def test_by_default_a_code_counts_until_its_ratio_is_off_by_a_fifth(ratio, advantage, counts):
    """Its gradient is gone where it has moved so far in the direction of its advantage."""
    policy = t(math.log(ratio)).requires_grad_()
    told = grpo_loss(
        policy=policy, old=t(0), advantages=t(advantage), kl=t(0), clip=AlignTraining().ratio_clip, kl_weight=0.0
    )
    told.loss.backward()
    assert policy.grad.item() == pytest.approx(-advantage * ratio if counts else 0)


TRL_DPO = {
    0.1: (0.6711532597927776, [-0.023875758760409996, -0.025], 0.045),
    0.5: (0.5931980632787001, [-0.09734019151269449, -0.125], 0.225),
}


@pytest.mark.parametrize("beta", TRL_DPO)
def test_dpo_is_trls(beta):
    """TRL 1.16.0, of two codes a continuation: loss, gradient by chosen code (rejected: the opposite), margin."""
    chosen, rejected = (
        torch.tensor(rows, dtype=torch.float64, requires_grad=True)
        for rows in ([[-1.0, -2.5], [-0.7, -1.2]], [[-2.0, -0.1], [-1.5, -1.5]])
    )
    told = dpo_loss(
        chosen=chosen.sum(1),
        rejected=rejected.sum(1),
        reference_chosen=t(-1.4 - 2.6, -0.6 - 1.0),
        reference_rejected=t(-1.2 - 0.5, -1.6 - 1.1),
        beta=beta,
    )
    told.loss.backward()
    loss, gradient, margin = TRL_DPO[beta]
    assert told.loss.item() == pytest.approx(loss, rel=1e-12)
    wanted = torch.tensor(gradient, dtype=torch.float64)[:, None].expand(2, 2)
    torch.testing.assert_close(chosen.grad, wanted)
    torch.testing.assert_close(rejected.grad, -wanted)
    assert (told.margin.item(), told.accuracy.item()) == pytest.approx((margin, 0.5))


def test_on_policy_the_gradient_of_grpo_is_that_of_reinforce():
    """With old = policy every ratio is 1, and d loss / d log p = -A / n."""
    policy = t(-1.0, -2.0).requires_grad_()
    told = grpo_loss(policy=policy, old=policy.detach(), advantages=t(2.0, -1.0), kl=t(0, 0), clip=0.2, kl_weight=0.0)
    told.loss.backward()
    torch.testing.assert_close(policy.grad, t(-1.0, 0.5))


def test_dpo_by_hand():
    """Chosen rises by 2 over the reference, rejected by -1: margin 0.1 x 3, loss -ln sigmoid(0.3) = 0.5544."""
    told = dpo_loss(chosen=t(-8.0), rejected=t(-11.0), reference_chosen=t(-10.0), reference_rejected=t(-10.0), beta=0.1)
    assert told.loss.item() == pytest.approx(-math.log(1 / (1 + math.exp(-0.3))))
    assert told.loss.item() == pytest.approx(0.5544, abs=1e-4)
    assert told.margin.item() == pytest.approx(0.3)
    assert told.accuracy.item() == 1.0


def test_advantages_of_gae_by_hand():
    """Discount 1, decay 0.5, rewards 0, 1, values 0.2, 0.4: surprises 0.2, 0.6; so 0.2 + 0.3, 0.6; returns 0.7, 1."""
    advantages, returns = generalised_advantages(t(0, 1)[None], t(0.2, 0.4)[None], discount=1.0, decay=0.5)
    torch.testing.assert_close(advantages, t(0.5, 0.6)[None])
    torch.testing.assert_close(returns, t(0.7, 1.0)[None])
    with_everything, _ = generalised_advantages(t(0, 1)[None], t(0.2, 0.4)[None], discount=1.0, decay=1.0)
    torch.testing.assert_close(with_everything, t(0.8, 0.6)[None])  # returns less values


def test_ppo_by_hand():
    """Ratio 1.5 at advantage 1 clips to 1.2; values move by 0.5 from 0, may count for 0.2 only; (1 - 0.2)^2 / 2."""
    told = ppo_loss(
        policy=t(math.log(1.5))[None], old=t(0.0)[None], advantages=t(1.0)[None],
        values=t(0.5)[None], old_values=t(0.0)[None], returns=t(1.0)[None], clip=0.2,
    )  # fmt: skip
    assert told.policy.item() == pytest.approx(-1.2)
    assert told.value.item() == pytest.approx(0.32)
    assert told.clipped.item() == 1.0


def test_gradients_agree_with_finite_differences():
    random = torch.Generator().manual_seed(1)
    a, b, c = (torch.randn(2, 3, generator=random, dtype=torch.float64) for _ in range(3))
    policy = (a - 1).requires_grad_()

    def grpo(p):
        return grpo_loss(policy=p, old=b - 1, advantages=c, kl=k3(p, b - 1.1), clip=5.0, kl_weight=0.01).loss

    def dpo(p):
        return dpo_loss(chosen=p[0], rejected=p[1], reference_chosen=b[0], reference_rejected=b[1], beta=0.1).loss

    def ppo(p):
        told = ppo_loss(policy=p, old=b - 1, advantages=c, values=p, old_values=a, returns=b, clip=5.0)
        return told.policy + told.value

    for loss in (grpo, dpo, ppo):
        assert torch.autograd.gradcheck(loss, (policy,))
