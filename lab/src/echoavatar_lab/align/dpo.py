"""DPO: learns from preferred and rejected continuations of the same prompt (paper, Direct Preference Alignment)."""

import hashlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar_lab.training import Loss

from .losses import dpo_loss
from .policy import GeneratorPolicy
from .preferences import PreferencePair, codes_of
from .prompts import Prompt, PromptBatch, batch_of
from .trainer import PolicyTask


class PairBatch(NamedTuple):
    """Preference pairs, one a row."""

    prompts: PromptBatch
    chosen: Int[Tensor, "b n p q"]
    rejected: Int[Tensor, "b n p q"]


class DpoTask(PolicyTask[PairBatch]):
    """Goes through the pairs in a new order every pass. Log-probabilities include temperature but no nucleus.

    A pair may come from another model. A code outside this policy's nucleus would have log-probability -inf.
    """

    def __init__(self, *args: Any, pairs: Sequence[tuple[Prompt, PreferencePair]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._pairs = list(pairs)

    def data_fingerprint(self) -> str:
        """See `PolicyTask.data_fingerprint`."""
        return hashlib.sha256("".join(pair.model_dump_json() for _, pair in self._pairs).encode()).hexdigest()

    def draw(self, step: int) -> PairBatch:
        """The pairs of a step."""
        drawn = [self._pairs[at] for at in self.order(step)]
        pairs = [pair for _, pair in drawn]
        prompts = batch_of([prompt for prompt, _ in drawn])
        return PairBatch(prompts, codes_of(pairs, "chosen"), codes_of(pairs, "rejected"))

    def loss(self, batch: PairBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        own = [self.policy.score(batch.prompts, part, uses_nucleus=False) for part in batch[1:]]
        with torch.no_grad():
            other = [_sums(self.reference, batch.prompts, part) for part in batch[1:]]
        kl = self.divergence(own[0], batch.prompts, batch.chosen)
        found = dpo_loss(
            chosen=own[0].log_probs.sum((1, 2)),
            rejected=own[1].log_probs.sum((1, 2)),
            reference_chosen=other[0],
            reference_rejected=other[1],
            beta=self.config.beta,
        )
        logged = {"margin": found.margin, "accuracy": found.accuracy}
        return Loss(found.loss, self.logged(logged, kl, own[0]))

    def order(self, step: int) -> list[int]:
        """Indices of a step's pairs: every pass is a new permutation; a batch may span two passes."""
        batch, count = self.config.batch, len(self._pairs)
        at = np.arange(step * batch, (step + 1) * batch)
        orders = {
            int(turn): np.random.default_rng([self.config.seed, int(turn)]).permutation(count)
            for turn in np.unique(at // count)
        }
        return [int(orders[int(k // count)][k % count]) for k in at]


def _sums(policy: GeneratorPolicy, prompts: PromptBatch, codes: Int[Tensor, "b n p q"]) -> Float[Tensor, " b"]:
    return policy.score(prompts, codes, uses_nucleus=False).log_probs.sum((1, 2))
