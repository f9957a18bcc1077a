"""GRPO: compares the continuations of a prompt with each other (paper, Reward-Guided Optimization)."""

from torch import Tensor

from echoavatar_lab.training import Loss

from .losses import group_advantages, grpo_loss, timed_advantages
from .rollouts import JudgedRollouts, RolloutBatch, RolloutTask


class GrpoTask(RolloutTask):
    """Rollouts, rewards, advantages normalised within each group, one or several steps on them."""

    def advantages_and_returns(self, judged: JudgedRollouts, made: RolloutBatch) -> tuple[Tensor, None]:
        """Advantages within each group; there is no critic, so no returns."""
        training = self.config
        grouped = (training.batch, training.group)
        if training.credit == "sequence":
            by_row = group_advantages((judged.tokens.sum(1) + judged.whole).view(grouped))
            return by_row.flatten()[:, None].expand_as(judged.tokens), None
        tokens, whole = judged.tokens.view(*grouped, -1), judged.whole.view(grouped)
        return timed_advantages(tokens, whole, training.discount).flatten(0, 1), None

    def loss(self, batch: RolloutBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        scores = self.policy.score(batch.prompts, batch.codes, batch.support)
        kl = self.divergence(scores, batch.prompts, batch.codes)
        found = grpo_loss(
            policy=scores.log_probs,
            old=scores.log_probs.detach() if batch.old is None else batch.old,
            advantages=self.credited(batch.advantages),
            kl=kl,
            clip=self.config.ratio_clip,
            kl_weight=self.config.kl_weight,
        )
        return Loss(found.loss, self.logged(self.logged_means(batch) | {"clipped": found.clipped}, kl, scores))
