"""What GRPO, DPO and PPO share as training tasks: settings and recipes, policy, reference, measurements, checkpoints.

The recipes are tiny (tests), rehearsal (the default bundle) and paper. The loop itself, exact resume, several
processes, bfloat16 and signals come from `training`. A batch depends only on the policy's weights, the run's seed and
the step number, so a killed run repeats bit by bit what it would have done.
"""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, NamedTuple, Self, TypeVar

import torch
from jaxtyping import Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.paper import RL
from echoavatar_lab.training import Gather, Schedule, TrainingConfig, TrainingTask, adamw

from .policy import GeneratorPolicy, Rollout, Scores, check_reference, exact_kl, mean_by_layer
from .probe import Judge, Probe
from .prompts import Events, PromptBatch

Method = Literal["grpo", "dpo", "ppo"]


class AlignTraining(TrainingConfig):
    """How a policy is tuned. The defaults are the rehearsal recipe's.

    `batch` counts prompts (DPO: pairs); each prompt is continued `group` times.
    """

    method: Method = Field(default="grpo", description="grpo, dpo or ppo")
    steps: int = Field(default=200, gt=0, description="optimiser steps")
    batch: int = Field(default=4, gt=0, description="prompts, or pairs, a step (paper: 16)")
    accumulation: int = Field(default=1, gt=0, description="pieces of a batch; changes memory, not the result")
    group: int = Field(default=8, gt=0, description="continuations of a prompt (paper: GRPO 30, PPO 1, DPO's pairs 8)")
    past: int = Field(default=3, ge=0, description="chunks of true motion and audio before a continuation")
    own_past: int = Field(
        default=0, ge=0, description="chunks of the past that the policy makes itself, as in a session (paper: none)"
    )
    length: int = Field(default=9, gt=0, description="chunks of a continuation (paper: 15, 4 s)")
    fewest_events: int = Field(default=2, ge=0, description="beats or stressed syllables that a prompt must contain")
    events: Events = Field(default="any", description="which events count: any, beat (music) or stress (speech)")
    learning_rate: float = Field(default=1e-4, gt=0, description="AdamW (paper: 6e-5 at 0.5B)")
    schedule: Schedule = Field(default="constant", description="of the learning rate; constant lets a run be extended")
    warmup: int = Field(default=5, ge=0, description="steps of linear warm-up")
    weight_decay: float = Field(default=0.0, ge=0, description="AdamW's decay")
    epochs: int = Field(default=1, gt=0, description="optimiser steps on the same continuations")
    credit: Literal["sequence", "to_go"] = Field(
        default="to_go",
        description="sequence: one advantage for a whole continuation (paper); to_go: one for each motion token",
    )
    discount: float = Field(default=0.8, gt=0, le=1, description="to_go, ppo: discount a motion token (133 ms)")
    layers: int = Field(
        default=0,
        ge=0,
        description="RVQ layers, coarsest first, that rewards are credited to; 0: all (paper). KL counts in all",
    )
    kl_weight: float = Field(
        default=0.01, ge=0, description="weight of the KL divergence from the reference (paper: 0.01)"
    )
    kl_stop: float = Field(default=0.5, gt=0, description="mean KL in nats a code at which the run stops")
    ratio_clip: float = Field(default=0.2, gt=0, description="clipping range of the probability ratio")
    beta: float = Field(default=0.1, gt=0, description="dpo: strength of the preference (paper: 0.1)")
    critic_rate: float = Field(default=1e-5, gt=0, description="ppo: learning rate of the value head (paper: 1e-5)")
    gae: float = Field(default=0.95, ge=0, le=1, description="ppo: lambda of generalised advantages")
    probe: int = Field(default=24, gt=0, description="held-out prompts that progress is measured on")
    probe_group: int = Field(default=2, gt=0, description="continuations of each held-out prompt")
    evaluate_every: int = Field(default=20, ge=0, description="steps between held-out measurements")
    save_every: int = Field(default=10, ge=0, description="steps between checkpoints")
    videos: int = Field(default=1, ge=0, description="held-out prompts rendered at each checkpoint; 0: none")
    seed: int = Field(default=0, description="seed of prompts and sampled codes")

    @model_validator(mode="after")
    def _own_past_is_past(self) -> Self:
        if self.own_past > self.past:
            raise ValueError(f"own_past ({self.own_past}) chunks are the last of the past ({self.past})")
        return self

    @model_validator(mode="after")
    def _group_is_one(self) -> Self:
        if self.method == "grpo" and self.group < 2:
            raise ValueError("grpo compares the continuations of a prompt: group must be at least 2")
        return self


def recipe(name: str, method: Method) -> AlignTraining:
    """The settings of a recipe for a method: `tiny`, `rehearsal` or `paper`; or `targets`, those of `align targets`."""
    own: dict[str, object] = {"accumulation": 2}
    if method == "ppo":
        own = {"group": 1, "batch": 16}
    if method == "dpo":
        own = {"learning_rate": 3e-5}
    match name:
        case "tiny":
            sizes: dict[str, object] = {"steps": 4, "batch": 2, "past": 1, "length": 1, "probe": 2, "fewest_events": 0}
            sizes |= {"group": 1 if method == "ppo" else 4, "evaluate_every": 2, "save_every": 2, "videos": 0}
        case "rehearsal":
            sizes = own
        case "paper":
            sizes = dict(RL[method])
        case "targets":
            sizes = {"steps": 180, "batch": 64, "accumulation": 4, "past": 64, "own_past": 56, "length": 38}
            sizes |= {"learning_rate": 1.5e-4, "betas": (0.9, 0.98), "average": 0.97, "warmup": 8, "autocast": True}
            sizes |= {"layers": 3, "kl_weight": 0.04, "kl_stop": 2, "evaluate_every": 0, "save_every": 20}
        case _:
            raise ValueError(f"no recipe {name!r}: tiny, rehearsal, paper or targets")
    return AlignTraining.model_validate({"method": method} | sizes)


BatchT = TypeVar("BatchT")


class DivergedError(EchoAvatarError):
    """The policy has moved further from its reference than allowed; the last checkpoint is from before."""


class Origin(Config):
    """What a resumed run must also agree in: the reference's weights, the rewards, the pairs."""

    reference: str
    rewards: dict[str, float] = {}
    pairs: str = ""


class RunContext(NamedTuple):
    """Optional companions of a run: card, held-out measurement, videos, names, rollout backend."""

    card: Mapping[str, object] = {}
    probe: Probe | None = None
    sample_writer: Callable[[GeneratorPolicy, Path], None] | None = None  # its files are named after the path
    rewards: Mapping[str, float] = {}
    reference_name: str = "the reference"
    rollouts: Callable[[GeneratorPolicy], Rollout] | None = None  # replaces the policy's own sampling


NO_CONTEXT = RunContext()


class PolicyTask(TrainingTask[BatchT]):
    """A policy that learns, and the reference that it must stay close to."""

    config: AlignTraining
    data_fingerprint = ""
    """Fingerprint of training data other than the token files, if there is any."""

    def __init__(
        self,
        generator: Generator,
        reference: Generator,
        training: AlignTraining,
        judge: Judge,
        context: RunContext = NO_CONTEXT,
        critic: nn.Module | None = None,
    ) -> None:
        """The weights of exemplar control are not trained.

        Raises CheckpointError if the reference has another vocabulary.
        """
        check_reference(generator, reference, name=context.reference_name)
        for name, parameter in generator.named_parameters():
            parameter.requires_grad_(not name.startswith("exemplar."))
        super().__init__(training, {"model": generator} | ({"critic": critic} if critic is not None else {}))
        self.policy = GeneratorPolicy(generator)
        self.reference = GeneratorPolicy(reference.eval().requires_grad_(False), self.policy.sampling)
        self.judge, self.context, self.critic = judge, context, critic
        self._divergence = torch.zeros(2)  # sum of the KL over this process's rows in a step, and their number

    @property
    def generator(self) -> Generator:
        """The generator that is tuned."""
        return self.policy.generator

    @property
    def device(self) -> torch.device:
        """The policy's device."""
        return next(self.generator.parameters()).device

    def identity(self) -> Mapping[str, Config]:
        """Steps may be added to a run; its model, reference and rewards may not change."""
        origin = Origin(
            reference=fingerprint(self.reference.generator),
            rewards=dict(self.context.rewards),
            pairs=self.data_fingerprint,
        )
        training = self.config.model_copy(update={"steps": 1})
        return {"training": training, "generator": self.generator.config, "origin": origin}

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW over the policy; also moves the reference to the policy's device."""
        self.reference.generator.to(self.device)
        return [adamw([self.generator], self.config)]

    def clipped_parameters(self) -> list[nn.Parameter]:
        """The policy's parameters; the critic's gradient is not clipped."""
        return list(self.generator.parameters())

    def divergence(self, scores: Scores, prompts: PromptBatch, codes: Int[Tensor, "b n p q"]) -> Float[Tensor, "b n k"]:
        """Exact KL of the policy from the reference, over the support that codes were sampled from."""
        with torch.no_grad():
            other = self.reference.score(prompts, codes, scores.support)
        return exact_kl(scores.all_log_probs, other.all_log_probs, scores.support)

    def logged(
        self, values: Mapping[str, Tensor], kl: Float[Tensor, "b n k"], scores: Scores
    ) -> dict[str, Tensor | float]:
        """Logged values of some rows; also records the divergence for `after`."""
        self._divergence += torch.tensor([float(kl.detach().mean((1, 2)).sum()), len(kl)])
        entropy = mean_by_layer(scores.entropy, self.policy.layout.motion_layers)
        return dict(values) | {"kl": kl.mean()} | {f"entropy.{at}": one for at, one in enumerate(entropy)}

    def after(self, step: int, gather: Gather) -> None:
        """Stop a run that diverges.

        Raises DivergedError if the mean divergence of the step's continuations exceeds `kl_stop`.
        """
        total = gather(self._divergence.to(self.device)[None]).sum(0)
        self._divergence = torch.zeros(2)
        if (kl := float(total[0] / total[1])) > self.config.kl_stop:
            raise DivergedError(f"KL {kl:.3f} at step {step + 1} is over kl_stop {self.config.kl_stop}")

    @torch.no_grad()
    def evaluate(self) -> Mapping[str, object]:
        """Rewards, divergence, entropy, FID and beat alignment on the same held-out prompts every time."""
        probe = self.context.probe
        return {} if probe is None else {"held_out": probe(self.policy, self.reference)}

    def save(self, folder: Path, step: int) -> None:
        """Write the generator, and videos of held-out prompts."""
        about = {"kind": "generator", "step": step, "alignment": self.config.model_dump()}
        self.generator.save(folder, dict(self.context.card) | about)
        if self.context.sample_writer is not None:
            self.context.sample_writer(self.policy, folder / "samples" / f"step_{step:06d}")


def rollout_seeds(training: AlignTraining, number: int, rows: int) -> Int[Tensor, " r"]:
    """Seeds of a batch's continuations, from the run's seed and the batch's number."""
    random = torch.Generator().manual_seed((training.seed * 1_000_003 + number) * 7)
    return torch.randint(2**62, (rows,), generator=random)


def fingerprint(model: torch.nn.Module) -> str:
    """A hash of all weights by name."""
    digest = hashlib.sha256()
    for name, value in sorted(model.state_dict().items()):
        digest.update(name.encode())
        digest.update(value.detach().float().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
