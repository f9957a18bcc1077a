"""Measures a policy on held-out prompts, with the same prompts and seeds every time."""

import time
from collections.abc import Mapping, Sequence

import torch

from .judge import DecodingJudge, Judge, concatenated
from .losses import exact_kl
from .motion_metrics import MotionMetrics, mean_and_error
from .policy import GeneratorPolicy, mean_by_layer
from .prompts import Prompt, batch_of
from .rewards import Rewards

TOGETHER = 8  # prompts whose continuations are drawn and scored at once
SEED = 987_654_321  # different from any run's own seed


class Probe:
    """Rewards, divergence and entropy of a policy; with `motion_metrics` also FID, diversity and beat alignment."""

    def __init__(
        self,
        prompts: Sequence[Prompt],
        judge: Judge,
        *,
        group: int,
        motion_metrics: MotionMetrics | None = None,
        seed: int = SEED,
    ) -> None:
        """`motion_metrics` needs a judge that decodes motion (`DecodingJudge`)."""
        self.prompts, self._judge, self._group = list(prompts), judge, group
        self._motion_metrics, self._seed = motion_metrics, seed

    @torch.no_grad()
    def __call__(self, policy: GeneratorPolicy, reference: GeneratorPolicy) -> dict[str, object]:
        """Means with standard errors over prompts.

        `by_prompt` allows a paired comparison with an earlier measurement (`plots.gain`): prompts differ from each
        other far more than a tuned policy differs from the one it started as.
        """
        began, group = time.monotonic(), self._group
        random = torch.Generator().manual_seed(self._seed)
        seeds = torch.randint(2**62, (len(self.prompts), group), generator=random)
        device = str(next(policy.generator.parameters()).device)
        codes, kl, entropy = [], [], []
        for at in range(0, len(self.prompts), TOGETHER):
            batch = batch_of(self.prompts[at : at + TOGETHER], device)
            codes.append(policy.rollout(batch, group, seeds[at : at + TOGETHER].flatten().to(device)))
            every = batch.repeated(group)
            own = policy.score(every, codes[-1])
            other = reference.score(every, codes[-1], own.support)
            kl.append(exact_kl(own.all_log_probs, other.all_log_probs, own.support))
            entropy.append(own.entropy)
        rewards, cost = self._judged(torch.cat(codes))
        by_prompt = {
            name: values.reshape(-1, group).mean(1) for name, values in {"": rewards.total, **rewards.parts}.items()
        }
        return {
            "reward": mean_and_error(by_prompt[""]),
            "rewards": {name: mean_and_error(values) for name, values in by_prompt.items() if name},
            "by_prompt": [round(float(mean), 5) for mean in by_prompt[""]],
            "kl": float(torch.cat(kl).mean()),
            "entropy": mean_by_layer(torch.cat(entropy), policy.layout.motion_layers),
            **cost,
            "seconds": round(time.monotonic() - began, 2),
        }

    def _judged(self, codes: torch.Tensor) -> tuple[Rewards, Mapping[str, object]]:
        if self._motion_metrics is None:
            return self._judge(self.prompts, codes), {}
        assert isinstance(self._judge, DecodingJudge)
        each, group, motions, found = TOGETHER, self._group, [], []
        for at in range(0, len(self.prompts), each):
            some = self.prompts[at : at + each]
            made = self._judge.motions(some, codes[at * group : (at + len(some)) * group])
            found.append(self._judge.mix(made))
            motions += made
        return concatenated(found), self._motion_metrics(motions)
