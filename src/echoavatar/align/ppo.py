"""PPO with a value head (paper, Comparison with PPO): one continuation a prompt, critic learning rate 1e-5."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from .losses import generalised_advantages, ppo_loss
from .policy import by_layer
from .prompts import PromptBook, batch_of
from .trainer import AlignTrainer, Told, told_rewards


class ValueHead(nn.Module):
    """Foretells the return from the hidden state that predicts a motion token's first code; begins at zero.

    It reads the state detached, so that its error does not move the policy.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.value = nn.Linear(width, 1)
        nn.init.zeros_(self.value.weight)
        nn.init.zeros_(self.value.bias)

    def forward(self, hidden: Float[Tensor, "b n k c"]) -> Float[Tensor, "b n"]:
        """One value a motion token."""
        values: Tensor = self.value(hidden[:, :, 0].detach().float())
        return values[..., 0]


class PpoTrainer(AlignTrainer):
    """Clipped surrogate with generalised advantages; what is said of a whole continuation is spread over its tokens."""

    def __init__(self, *args: Any, book: PromptBook, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._book = book
        self.critic = ValueHead(self.generator.config.width).to(self.device)
        self.optimisers.append(self._adamw(list(self.critic.parameters()), self.training.critic_rate))

    def modules(self) -> dict[str, nn.Module]:
        """See `AlignTrainer.modules`."""
        return super().modules() | {"critic": self.critic}

    def step(self) -> Told:
        """See `AlignTrainer.step`."""
        training = self.training
        prompts = self._book.draw(self.next_step, training.batch)
        rows = training.batch * training.group
        every = batch_of(prompts, self.device).repeated(training.group)
        codes = self.policy.rollout(batch_of(prompts, self.device), training.group, self.seeds(rows))
        rewards = self.judge(prompts, codes)
        tokens, whole = (torch.from_numpy(part).float().to(self.device) for part in rewards[:2])
        old, support, values = self._before(every, codes)
        advantages, returns = generalised_advantages(
            tokens + whole[:, None] / tokens.shape[1], values, discount=training.discount, decay=training.gae
        )
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        sums = dict.fromkeys(("policy", "value", "clipped", "kl"), 0.0)
        entropy, norm = torch.zeros(self.policy.layout.motion_layers), 0.0
        for _ in range(training.epochs):
            sums, entropy = dict.fromkeys(sums, 0.0), torch.zeros_like(entropy)
            for start in range(0, rows, training.micro):
                at = slice(start, min(start + training.micro, rows))
                share = (at.stop - at.start) / rows
                scores = self.policy.score(every.rows(at), codes[at], support[at])
                kl = self.divergence(scores, every.rows(at), codes[at]).mean()
                told = ppo_loss(
                    policy=scores.log_probs,
                    old=old[at],
                    advantages=advantages[at, :, None],
                    values=self.critic(scores.hidden),
                    old_values=values[at],
                    returns=returns[at],
                    clip=training.clip,
                )
                loss = told.policy + told.value + training.kl_weight * kl
                (loss * share).backward()  # type: ignore[no-untyped-call]
                for name, value in (*told._asdict().items(), ("kl", kl)):
                    sums[name] += float(value.detach()) * share
                entropy += share * torch.tensor(by_layer(scores.entropy, len(entropy)))
            norm = self.descend()
        self.next_step += 1
        return told_rewards(rewards, training.group) | {"gradient": norm, "entropy": entropy.tolist()} | sums

    @torch.no_grad()
    def _before(self, every: Any, codes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Log-probabilities, supports and values under the policy that sampled."""
        parts = []
        for start in range(0, len(codes), self.training.micro):
            at = slice(start, start + self.training.micro)
            scores = self.policy.score(every.rows(at), codes[at])
            parts.append((scores.log_probs, scores.support, self.critic(scores.hidden)))
        old, support, values = (torch.cat(column) for column in zip(*parts, strict=True))
        return old, support, values
