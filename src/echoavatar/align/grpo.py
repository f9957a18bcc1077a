"""GRPO: continuations of a prompt are compared with each other (paper, Reward-Guided Optimization)."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from .losses import group_advantages, grpo_loss, timed_advantages
from .policy import Scores, by_layer
from .prompts import PromptBook, batch_of
from .rewards import Rewards
from .trainer import AlignTrainer, Told, told_rewards


class GrpoTrainer(AlignTrainer):
    """Rollouts, rewards, group-normalised advantages, one or a few passes."""

    def __init__(self, *args: Any, book: PromptBook, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._book = book

    def step(self) -> Told:
        """See `AlignTrainer.step`."""
        training = self.training
        prompts = self._book.draw(self.next_step, training.batch)
        batch = batch_of(prompts, self.device)
        rows = training.batch * training.group
        codes = self.policy.rollout(batch, training.group, self.seeds(rows))
        rewards = self.judge(prompts, codes)
        advantages = self._advantages(rewards)
        every, stored = batch.repeated(training.group), self._stored(batch.repeated(training.group), codes)
        sums, norm = {"kl": 0.0, "clipped": 0.0, "loss": 0.0}, 0.0
        entropy = torch.zeros(self.policy.layout.motion_layers)
        for _ in range(training.epochs):
            sums, entropy = dict.fromkeys(sums, 0.0), torch.zeros_like(entropy)
            for start in range(0, rows, training.micro):
                at = slice(start, min(start + training.micro, rows))
                share = (at.stop - at.start) / rows
                support = stored[1][at] if stored else None
                scores = self.policy.score(every.rows(at), codes[at], support)
                old = stored[0][at] if stored else scores.log_probs.detach()
                kl = self.divergence(scores, every.rows(at), codes[at])
                told = grpo_loss(
                    policy=scores.log_probs,
                    old=old,
                    advantages=advantages[at, :, None],
                    kl=kl,
                    clip=training.clip,
                    kl_weight=training.kl_weight,
                )
                (told.loss * share).backward()  # type: ignore[no-untyped-call]
                for name in sums:
                    sums[name] += float(getattr(told, name).detach()) * share
                entropy += share * torch.tensor(by_layer(scores.entropy, len(entropy)))
            norm = self.descend()
        self.next_step += 1
        return (
            told_rewards(rewards, training.group)
            | {
                "gradient": norm,
                "entropy": entropy.tolist(),
            }
            | sums
        )

    def _advantages(self, rewards: Rewards) -> Float[Tensor, "r n"]:
        training = self.training
        tokens, whole = (torch.from_numpy(part).float().to(self.device) for part in rewards[:2])
        grouped = (training.batch, training.group)
        if training.credit == "sequence":
            by_row = group_advantages((tokens.sum(1) + whole).view(grouped))
            return by_row.flatten()[:, None].expand_as(tokens)
        by_time = timed_advantages(tokens.view(*grouped, -1), whole.view(grouped), training.discount)
        return by_time.flatten(0, 1)

    @torch.no_grad()
    def _stored(self, every: Any, codes: Tensor) -> tuple[Tensor, Tensor] | None:
        """Log-probabilities and supports under the policy that sampled; with one pass that is the policy itself."""
        if self.training.epochs == 1:
            return None
        parts: list[Scores] = []
        for start in range(0, len(codes), self.training.micro):
            at = slice(start, start + self.training.micro)
            parts.append(self.policy.score(every.rows(at), codes[at]))
        return torch.cat([part.log_probs for part in parts]), torch.cat([part.support for part in parts])
