"""The losses of GRPO, DPO and PPO (paper, equations GRPO and DPO, and Comparison with PPO), in nats.

All log-probabilities are those of the constrained distribution that codes are sampled from (`policy`). Continuations
have one fixed length, so a mean over codes weights them equally and needs neither mask nor end token.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

CLIP = 0.2
SPREAD_FLOOR = 1e-4  # added to a group's deviation, as in TRL: a group of equal rewards has no advantages


class GrpoLoss(NamedTuple):
    """The loss and its diagnostics."""

    loss: Float[Tensor, ""]
    kl: Float[Tensor, ""]
    clipped: Float[Tensor, ""]  # share of codes whose ratio was clipped


class DpoLoss(NamedTuple):
    """The loss and its diagnostics."""

    loss: Float[Tensor, ""]
    margin: Float[Tensor, ""]  # of the implicit rewards, chosen over rejected
    accuracy: Float[Tensor, ""]  # share of pairs with a positive margin


class PpoLoss(NamedTuple):
    """Losses of the policy and of its critic."""

    policy: Float[Tensor, ""]
    value: Float[Tensor, ""]
    clipped: Float[Tensor, ""]


def group_advantages(rewards: Float[Tensor, "b g"]) -> Float[Tensor, "b g"]:
    """Paper: (r_i - mu_G) / sigma_G of each group (spread with n - 1, plus 1e-4, as TRL)."""
    spread = rewards.std(1, keepdim=True) if rewards.shape[1] > 1 else torch.zeros_like(rewards)
    return (rewards - rewards.mean(1, keepdim=True)) / (spread + SPREAD_FLOOR)


def rewards_to_go(rewards: Float[Tensor, "... n"], discount: float) -> Float[Tensor, "... n"]:
    """The sum of each step's reward and the later ones, discounted by `discount` a step."""
    running, out = torch.zeros_like(rewards[..., 0]), []
    for step in reversed(rewards.unbind(-1)):
        running = step + discount * running
        out.append(running)
    return torch.stack(out[::-1], -1)


def timed_advantages(
    rewards: Float[Tensor, "b g n"], whole: Float[Tensor, "b g"], discount: float
) -> Float[Tensor, "b g n"]:
    """Advantages by motion token: rewards to go minus the group's mean at that time, divided by the group's deviation.

    `whole` is the part of the reward that belongs to no particular time; it counts for every code.

    Departs from the paper, which gives every code of a continuation the same advantage (`group_advantages` of summed
    rewards; the same as discount 1 with one reward at the end). A code affects only what follows, and after a second
    hardly anything, so most of the variance of the sum is noise to it.
    """
    to_go = rewards_to_go(rewards, discount) + whole[..., None]
    centred = to_go - to_go.mean(1, keepdim=True)
    if rewards.shape[1] < 2:
        return torch.zeros_like(centred)
    spread = (centred.square().sum((1, 2), keepdim=True) / ((rewards.shape[1] - 1) * rewards.shape[2])).sqrt()
    return centred / (spread + SPREAD_FLOOR)


def exact_kl(
    policy: Float[Tensor, "... K"], reference: Float[Tensor, "... K"], support: Bool[Tensor, "... K"]
) -> Float[Tensor, "..."]:
    """KL(policy || reference) over one support; without sampling noise, because all K logits are known."""
    gap = torch.where(support, policy - reference, 0.0)
    return (policy.exp() * gap).sum(-1)


def grpo_loss(
    *,
    policy: Float[Tensor, "b ..."],
    old: Float[Tensor, "b ..."],
    advantages: Float[Tensor, "b ..."],
    kl: Float[Tensor, "b ..."],
    clip: float = CLIP,
    kl_weight: float = 0.01,
) -> GrpoLoss:
    """Group-relative policy loss (paper, equation GRPO), averaged over codes.

    Departs from the equation: ratios are clipped for each code, as in DeepSeekMath and TRL (`loss_type="grpo"`).
    `advantages` broadcasts: one a row, or one a code. `kl` is that of each code, with its gradient.
    """
    surrogate, clipped = _surrogate(policy, old, advantages, clip)
    return GrpoLoss((kl_weight * kl - surrogate).mean(), kl.mean(), clipped)


def _surrogate(
    policy: Float[Tensor, "b ..."], old: Float[Tensor, "b ..."], advantages: Float[Tensor, "b ..."], clip: float
) -> tuple[Float[Tensor, "b ..."], Float[Tensor, ""]]:
    """The clipped surrogate of each code, and the share of codes whose ratio was clipped."""
    ratio = (policy - old).exp()
    free, limited = ratio * advantages, ratio.clamp(1 - clip, 1 + clip) * advantages
    return torch.minimum(free, limited), (free > limited).float().mean()


def dpo_loss(
    *,
    chosen: Float[Tensor, " b"],
    rejected: Float[Tensor, " b"],
    reference_chosen: Float[Tensor, " b"],
    reference_rejected: Float[Tensor, " b"],
    beta: float = 0.1,
) -> DpoLoss:
    """Direct preference loss (paper, equation DPO) from log-probabilities summed over each continuation."""
    margin = beta * ((chosen - reference_chosen) - (rejected - reference_rejected))
    return DpoLoss(-F.logsigmoid(margin).mean(), margin.mean(), (margin > 0).float().mean())


def generalised_advantages(
    rewards: Float[Tensor, "b n"], values: Float[Tensor, "b n"], *, discount: float = 1.0, decay: float = 0.95
) -> tuple[Float[Tensor, "b n"], Float[Tensor, "b n"]]:
    """Generalised advantages by step, and the returns that the critic learns; nothing follows the last step."""
    following = torch.cat([values[:, 1:], torch.zeros_like(values[:, :1])], 1)
    surprise = rewards + discount * following - values
    advantages = rewards_to_go(surprise, discount * decay)
    return advantages, advantages + values


def ppo_loss(
    *,
    policy: Float[Tensor, "b ..."],
    old: Float[Tensor, "b ..."],
    advantages: Float[Tensor, "b ..."],
    values: Float[Tensor, "b m"],
    old_values: Float[Tensor, "b m"],
    returns: Float[Tensor, "b m"],
    clip: float = CLIP,
) -> PpoLoss:
    """Clipped surrogate, and clipped value loss (half the larger squared error), each averaged."""
    surrogate, clipped = _surrogate(policy, old, advantages, clip)
    near = old_values + (values - old_values).clamp(-clip, clip)
    value = 0.5 * torch.maximum((values - returns).square(), (near - returns).square())
    return PpoLoss(-surrogate.mean(), value.mean(), clipped)
