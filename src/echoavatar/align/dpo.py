"""DPO: preferred against rejected continuations of the same prompt (paper, Direct Preference Alignment)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from .losses import dpo_loss
from .policy import GeneratorPolicy, by_layer
from .preferences import Pair, codes_of
from .prompts import Prompt, PromptBatch, batch_of
from .trainer import AlignTrainer, Told


class DpoTrainer(AlignTrainer):
    """Pairs in a new order every pass; log-probabilities are of the sharpened distribution, without nucleus.

    A pair may come from elsewhere, with codes outside this policy's nucleus, whose log-probability would be -inf.
    """

    def __init__(self, *args: Any, pairs: Sequence[tuple[Prompt, Pair]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._pairs = list(pairs)

    def step(self) -> Told:
        """See `AlignTrainer.step`."""
        training = self.training
        chosen = [self._pairs[at] for at in self._order()]
        batch = batch_of([prompt for prompt, _ in chosen], self.device)
        codes = [
            codes_of([pair for _, pair in chosen], name).to(self.device) for name in ("chosen", "rejected")
        ]
        rows, each = len(chosen), max(1, training.micro // 2)
        sums = {"loss": 0.0, "margin": 0.0, "accuracy": 0.0, "kl": 0.0}
        entropy = torch.zeros(self.policy.layout.motion_layers)
        for start in range(0, rows, each):
            at = slice(start, min(start + each, rows))
            share, prompts = (at.stop - at.start) / rows, batch.rows(at)
            own = [self.policy.score(prompts, part[at], is_cut=False) for part in codes]
            with torch.no_grad():
                other = [_sums(self.reference, prompts, part[at]) for part in codes]
                kl = self.divergence(own[0], prompts, codes[0][at]).mean()
            told = dpo_loss(
                chosen=own[0].log_probs.sum((1, 2)),
                rejected=own[1].log_probs.sum((1, 2)),
                reference_chosen=other[0],
                reference_rejected=other[1],
                beta=training.beta,
            )
            (told.loss * share).backward()  # type: ignore[no-untyped-call]
            for name, value in (*told._asdict().items(), ("kl", kl)):
                sums[name] += float(value.detach()) * share
            entropy += share * torch.tensor(by_layer(own[0].entropy, len(entropy)))
        norm = self.descend()
        self.next_step += 1
        return {"gradient": norm, "entropy": entropy.tolist()} | sums

    def _order(self) -> list[int]:
        """The pairs of this step: each pass over all pairs is a permutation of its own."""
        batch, count = min(self.training.batch, len(self._pairs)), len(self._pairs)
        at = np.arange(self.next_step * batch, (self.next_step + 1) * batch)
        orders = {
            int(turn): np.random.default_rng([self.training.seed, int(turn)]).permutation(count)
            for turn in np.unique(at // count)
        }
        return [int(orders[int(k // count)][k % count]) for k in at]


def _sums(
    policy: GeneratorPolicy, prompts: PromptBatch, codes: Int[Tensor, "b n p q"]
) -> Float[Tensor, " b"]:
    return policy.score(prompts, codes, is_cut=False).log_probs.sum((1, 2))
