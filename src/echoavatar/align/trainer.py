"""One small trainer for GRPO, DPO and PPO: what differs is how a step makes its losses (`methods`).

Everything random in a step follows from the seed and the step's number, and a checkpoint holds weights, optimisers and
that number, so a run that was killed and resumed repeats to the bit what it would have done. Metrics go to
`metrics.jsonl`, a line a step; held-out prompts are answered every `probe_every` steps.
"""

import hashlib
import json
import math
import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from .. import checkpoint
from ..errors import CheckpointError
from ..generator import Generator
from .config import AlignTraining
from .losses import exact_kl
from .policy import GeneratorPolicy, Scores, by_layer, check_reference
from .prompts import Prompt, PromptBook, batch_of
from .rewards import Rewards

RESUME = "align.safetensors"
Told = dict[str, Any]
Judge = Callable[[Sequence[Prompt], Int[Tensor, "r n p q"]], Rewards]
"""Rewards of continuations; see `judge`."""


class AlignTrainer(ABC):
    """A policy, the reference it must stay near, an optimiser, and the number of the next step."""

    def __init__(
        self,
        generator: Generator,
        reference: Generator,
        training: AlignTraining,
        judge: Judge,
        *,
        device: str = "cpu",
        reference_name: str = "the reference",
    ) -> None:
        check_reference(generator, reference, name=reference_name)
        self.policy = GeneratorPolicy(generator.to(device).eval())
        self.reference = GeneratorPolicy(
            reference.to(device).eval().requires_grad_(False), self.policy.sampling
        )
        self.training, self.judge, self.next_step, self.device = training, judge, 0, device
        self.stopped = ""  # why a run ended early
        self.optimisers = [self._adamw(self.trained(), training.learning_rate)]

    @property
    def generator(self) -> Generator:
        """What is tuned."""
        return self.policy.generator

    def trained(self) -> list[nn.Parameter]:
        """Weights that take part; exemplar control is left as it was."""
        return [p for name, p in self.generator.named_parameters() if not name.startswith("exemplar.")]

    def modules(self) -> dict[str, nn.Module]:
        """What a checkpoint holds."""
        return {"model": self.generator}

    @staticmethod
    def _adamw(parameters: Sequence[nn.Parameter], rate: float) -> torch.optim.AdamW:
        return torch.optim.AdamW(parameters, lr=rate, betas=(0.9, 0.99), weight_decay=0.0)

    @abstractmethod
    def step(self) -> Told:
        """One batch; returns its metrics. Raises the number of the next step."""

    def seeds(self, rows: int, salt: int = 0) -> Int[Tensor, " r"]:
        """Seeds of this step's continuations, from the run's seed and the step's number."""
        random = torch.Generator().manual_seed((self.training.seed * 1_000_003 + self.next_step) * 7 + salt)
        return torch.randint(2**62, (rows,), generator=random).to(self.device)

    def divergence(self, scores: Scores, prompts: Any, codes: Tensor) -> Float[Tensor, "b n k"]:
        """KL of the policy from the reference, exact, over the support that codes were drawn from."""
        with torch.no_grad():
            other = self.reference.score(prompts, codes, scores.support)
        return exact_kl(scores.all_log_probs, other.all_log_probs, scores.support)

    def descend(self) -> float:
        """Clip, warm up, take one optimiser step; returns the norm of the gradient."""
        training = self.training
        norm = nn.utils.clip_grad_norm_(self.trained(), training.clip_norm)
        warm = min(1.0, (self.next_step + 1) / max(1, training.warmup))
        rates = (training.learning_rate, training.critic_rate)
        for optimiser, rate in zip(self.optimisers, rates, strict=False):
            for group in optimiser.param_groups:
                group["lr"] = rate * warm
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
        return float(norm)

    @torch.no_grad()
    def probe(self, prompts: Sequence[Prompt]) -> Told:
        """Rewards, divergence and entropy on prompts, drawn with the same seeds every time.

        `by_prompt` lets a measurement be compared with an earlier one prompt by prompt (`plots.gain`): prompts differ
        among each other by far more than a policy from the one it was.
        """
        group, began = self.training.probe_group, time.monotonic()
        random = torch.Generator().manual_seed(987_654_321)
        seeds = torch.randint(2**62, (len(prompts) * group,), generator=random).to(self.device)
        batch = batch_of(prompts, self.device)
        codes = self.policy.rollout(batch, group, seeds)
        rewards = self.judge(prompts, codes)
        every, kl, entropy = batch.repeated(group), [], []
        for start in range(0, len(codes), self.training.micro):
            rows = slice(start, start + self.training.micro)
            scores = self.policy.score(every.rows(rows), codes[rows])
            kl.append(self.divergence(scores, every.rows(rows), codes[rows]))
            entropy.append(scores.entropy)
        return {
            "probe": self.next_step,
            "reward": _mean_and_error(rewards.total, group),
            "rewards": {name: _mean_and_error(values, group) for name, values in rewards.parts.items()},
            "by_prompt": [round(float(mean), 5) for mean in rewards.total.reshape(-1, group).mean(1)],
            "kl": float(torch.cat(kl).mean()),
            "entropy": by_layer(torch.cat(entropy), self.policy.layout.motion_layers),
            "seconds": round(time.monotonic() - began, 2),
        }

    def save(self, folder: Path, card: Mapping[str, object]) -> None:
        """Everything a resumed run needs as one file, at once or not at all; then the generator as a checkpoint."""
        state = {
            f"{name}.{key}": value.detach().contiguous()
            for name, module in self.modules().items()
            for key, value in module.state_dict().items()
        }
        for which, optimiser in enumerate(self.optimisers):
            for index, values in optimiser.state_dict()["state"].items():
                state |= {f"optimiser.{which}.{index}.{name}": v.contiguous() for name, v in values.items()}
        facts = {
            "step": str(self.next_step),
            "stopped": self.stopped,
            "training": self.training.model_dump_json(exclude={"steps"}),
            "config": self.generator.config.model_dump_json(),
            "reference": fingerprint(self.reference.generator),
        }
        folder.mkdir(parents=True, exist_ok=True)
        partial = folder / f"{RESUME}.partial"
        save_file(state, partial, metadata=facts)
        partial.replace(folder / RESUME)
        told = {"kind": "generator", "step": self.next_step, "alignment": self.training.model_dump()}
        self.generator.save(folder, dict(card) | told)

    def resume(self, folder: Path) -> bool:
        """Continue from a folder written by `save`; False where there is none.

        Raises:
            CheckpointError: the folder is of another run, or damaged.
        """
        path = folder / RESUME
        if not path.exists():
            return False
        try:
            with safe_open(path, "pt") as file:
                facts = file.metadata()
            tensors = load_file(path)
        except SafetensorError as error:
            raise CheckpointError(f"{path} is damaged ({error}); delete it to begin again") from error
        own = {
            "training": self.training.model_dump_json(exclude={"steps"}),
            "config": self.generator.config.model_dump_json(),
            "reference": fingerprint(self.reference.generator),
        }
        for what, value in own.items():
            if facts.get(what) != value:
                raise CheckpointError(f"{folder} holds a run with another {what}; train into another folder")
        for name, module in self.modules().items():
            weights = {key[len(name) + 1 :]: v for key, v in tensors.items() if key.startswith(f"{name}.")}
            checkpoint.load_into(module, weights, origin=str(path))
        for which, optimiser in enumerate(self.optimisers):
            prefix, stored = f"optimiser.{which}.", defaultdict[int, dict[str, Tensor]](dict)
            for key in (key for key in tensors if key.startswith(prefix)):
                index, name = key[len(prefix) :].split(".", 1)
                stored[int(index)][name] = tensors[key]
            groups = optimiser.state_dict()["param_groups"]
            optimiser.load_state_dict({"state": dict(stored), "param_groups": groups})
        self.next_step, self.stopped = int(facts["step"]), facts["stopped"]
        return True


def run(
    trainer: AlignTrainer,
    folder: Path,
    *,
    held_out: PromptBook | None,
    card: Mapping[str, object],
    minutes: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Generator:
    """Train into `folder`, going on with what is there; stops at the schedule's end, after `minutes`, or when the
    divergence runs away (then `stopped` in the metrics says so, and the last checkpoint is from before).
    """
    training = trainer.training
    trainer.resume(folder)
    folder.mkdir(parents=True, exist_ok=True)
    log = _truncated(folder / "metrics.jsonl", trainer.next_step)
    probes = held_out.spread(training.probe) if held_out is not None else []
    deadline = math.inf if minutes is None else time.monotonic() + 60 * minutes
    with log.open("a") as out:

        def tell(told: Told) -> None:
            out.write(json.dumps(told) + "\n")
            out.flush()

        if probes and trainer.next_step == 0:
            tell(trainer.probe(probes))
        while trainer.next_step < training.steps and time.monotonic() < deadline and not trainer.stopped:
            began, number = time.monotonic(), trainer.next_step
            told = trainer.step()
            if told.get("kl", 0.0) > training.kl_stop:
                trainer.stopped = f"KL {told['kl']:.3f} at step {number} is over kl_stop {training.kl_stop}"
                tell({"step": number} | told | {"stopped": trainer.stopped})
                return _last_good(trainer, folder, card)
            tell({"step": number} | told | {"seconds": round(time.monotonic() - began, 2)})
            if probes and trainer.next_step % training.probe_every == 0:
                tell(trainer.probe(probes))
            if trainer.next_step % training.save_every == 0:
                trainer.save(folder, card)
            if progress is not None:
                progress(trainer.next_step, training.steps)
    trainer.save(folder, card)
    return trainer.generator


def fingerprint(generator: Generator) -> str:
    """Tells one set of weights from another: name, sum and sum of squares of every tensor, hashed."""
    digest = hashlib.sha256()
    for name, value in sorted(generator.state_dict().items()):
        digest.update(name.encode())
        digest.update(value.detach().float().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _last_good(trainer: AlignTrainer, folder: Path, card: Mapping[str, object]) -> Generator:
    """Back to the last checkpoint, marked as stopped, so that another call does not run away again."""
    why = trainer.stopped
    if not trainer.resume(folder):
        raise CheckpointError(
            f"{why}, before the first checkpoint; take a smaller learning rate or a larger kl_weight"
        )
    trainer.stopped = why
    trainer.save(folder, card)
    return trainer.generator


def _truncated(path: Path, step: int) -> Path:
    """Drop what a killed run told after its last checkpoint."""
    if path.exists():
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        kept = [
            line for line in lines if line.get("step", -1) < step and line.get("probe", -1) <= step and step
        ]
        path.write_text("".join(json.dumps(line) + "\n" for line in kept))
    return path


def _mean_and_error(values: Float[np.ndarray, " r"], group: int) -> list[float]:
    """Mean, and its standard error over prompts."""
    by_prompt = np.asarray(values).reshape(-1, group).mean(1)
    spread = by_prompt.std(ddof=1) if len(by_prompt) > 1 else 0.0
    return [round(float(by_prompt.mean()), 5), round(float(spread / len(by_prompt) ** 0.5), 5)]


def told_rewards(rewards: Rewards, group: int) -> Told:
    """Mean reward, its components, and the mean spread within groups."""
    spread = rewards.total.reshape(-1, group).std(1).mean()
    return {
        "reward": round(float(rewards.total.mean()), 5),
        "rewards": {name: round(float(values.mean()), 5) for name, values in rewards.parts.items()},
        "spread": round(float(spread), 5),
    }
