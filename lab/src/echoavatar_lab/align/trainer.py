"""What GRPO, DPO and PPO share as training tasks: policy, reference, held-out measurements, checkpoints.

The loop itself, exact resume, several processes, bfloat16 and signals come from `training`. A batch depends only on the
policy's weights, the run's seed and the step number, so a killed run repeats bit by bit what it would have done.
"""

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator import Generator
from echoavatar_lab.training import Gather, Loss, TrainingTask, adamw

from .config import AlignTraining
from .judge import Judge
from .losses import exact_kl
from .policy import GeneratorPolicy, Rollout, Scores, check_reference, mean_by_layer
from .probe import Probe
from .prompts import Prompt, PromptBatch

BatchT = TypeVar("BatchT")
SampleWriter = Callable[[GeneratorPolicy, Path], None]
"""Writes samples of a policy into a folder."""


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
    sample_writer: SampleWriter | None = None
    rewards: Mapping[str, float] = {}
    reference_name: str = "the reference"
    rollouts: Callable[[GeneratorPolicy], Rollout] | None = None  # replaces the policy's own sampling


NO_CONTEXT = RunContext()


class PolicyTask(TrainingTask[BatchT]):
    """A policy that learns, and the reference that it must stay close to."""

    config: AlignTraining

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

        Raises:
            CheckpointError: the reference has another vocabulary.
        """
        check_reference(generator, reference, name=context.reference_name)
        for name, parameter in generator.named_parameters():
            parameter.requires_grad_(not name.startswith("exemplar."))
        super().__init__(training, {"model": generator} | ({"critic": critic} if critic is not None else {}))
        self.policy = GeneratorPolicy(generator)
        self.reference = GeneratorPolicy(reference.eval().requires_grad_(False), self.policy.sampling)
        self.judge, self.context = judge, context
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
            pairs=self.data_fingerprint(),
        )
        training = self.config.model_copy(update={"steps": 1})
        return {"training": training, "generator": self.generator.config, "origin": origin}

    def data_fingerprint(self) -> str:
        """Fingerprint of training data other than the token files, if there is any."""
        return ""

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

    @abstractmethod
    def draw(self, step: int) -> BatchT:
        """See `TrainingTask.draw`."""

    def logged(
        self, values: Mapping[str, Tensor], kl: Float[Tensor, "b n k"], scores: Scores
    ) -> dict[str, Tensor | float]:
        """Logged values of some rows; also records the divergence for `after`."""
        self._divergence += torch.tensor([float(kl.detach().mean((1, 2)).sum()), len(kl)])
        entropy = mean_by_layer(scores.entropy, self.policy.layout.motion_layers)
        return dict(values) | {"kl": kl.mean()} | {f"entropy.{at}": one for at, one in enumerate(entropy)}

    @abstractmethod
    def loss(self, batch: BatchT, step: int) -> Loss:
        """See `TrainingTask.loss`."""

    def after(self, step: int, gather: Gather) -> None:
        """Stop a run that diverges.

        Raises:
            DivergedError: the mean divergence of the step's continuations exceeds `kl_stop`.
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


def share_of_process(prompts: Sequence[Prompt], processes: Any) -> Sequence[Prompt]:
    """The prompts of a batch that this process samples."""
    each = len(prompts) // processes.count
    return prompts[processes.rank * each : (processes.rank + 1) * each]
