"""PPO with a value head (paper, Comparison with PPO): one continuation a prompt, critic learning rate 1e-5."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from echoavatar.models.generator import Generator
from echoavatar_lab.training import Loss, adamw

from .config import AlignTraining
from .losses import generalised_advantages, ppo_loss
from .policy import Scores
from .rollouts import JudgedRollouts, RolloutBatch, RolloutTask


class ValueHead(nn.Module):
    """Predicts the return from the hidden state that predicts a motion token's first code; starts at zero.

    The state is detached, so the value error does not train the policy.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.value = nn.Linear(width, 1)
        nn.init.zeros_(self.value.weight)
        nn.init.zeros_(self.value.bias)

    def forward(self, hidden: Float[Tensor, "b n k c"]) -> Float[Tensor, "b n"]:
        """One value for each motion token."""
        values: Tensor = self.value(hidden[:, :, 0].detach().float())
        return values[..., 0].float()


class PpoTask(RolloutTask):
    """Clipped surrogate with generalised advantages; the reward of a whole continuation is spread over its tokens."""

    is_scored = True

    def __init__(
        self, generator: Generator, reference: Generator, training: AlignTraining, *args: Any, **kwargs: Any
    ) -> None:
        self.critic = ValueHead(generator.config.read_width)
        super().__init__(generator, reference, training, *args, critic=self.critic, **kwargs)

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """Adds an optimiser for the critic with its own learning rate."""
        critic = adamw([self.critic], self.config)
        for group in critic.param_groups:
            group["relative"] = self.config.critic_rate / self.config.learning_rate
        return [*super().optimisers(), critic]

    def predicted_values(self, scores: Scores) -> Float[Tensor, "r n"]:
        """See `RolloutTask.predicted_values`."""
        values: Tensor = self.critic(scores.hidden)
        return values

    def advantages_and_returns(self, judged: JudgedRollouts, made: RolloutBatch) -> tuple[Tensor, Tensor]:
        """Advantages, normalised over all continuations, and the critic's targets."""
        assert made.values is not None
        rewards = judged.tokens + judged.whole[:, None] / judged.tokens.shape[1]
        advantages, returns = generalised_advantages(
            rewards, made.values, discount=self.config.discount, decay=self.config.gae
        )
        return (advantages - advantages.mean()) / (advantages.std() + 1e-8), returns

    def loss(self, batch: RolloutBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        assert batch.old is not None
        assert batch.values is not None
        assert batch.returns is not None
        scores = self.policy.score(batch.prompts, batch.codes, batch.support)
        kl = self.divergence(scores, batch.prompts, batch.codes)
        found = ppo_loss(
            policy=scores.log_probs,
            old=batch.old,
            advantages=self.credited(batch.advantages),
            values=self.predicted_values(scores),
            old_values=batch.values,
            returns=batch.returns,
            clip=self.config.ratio_clip,
        )
        total = found.policy + found.value + self.config.kl_weight * kl.mean()
        return Loss(total, self.logged(self.logged_means(batch) | found._asdict(), kl, scores))
