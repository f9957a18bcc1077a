"""What GRPO, DPO and PPO have in common as stages of training (`training`): policy, reference, probes, what is saved.

The loop, exact resume, several processes, bfloat16 and signals are those of all stages. A batch comes from the policy's
own weights, the run's seed and the step's number, so a killed run repeats to the bit what it would have done.
"""

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from ..config import Config
from ..errors import EchoAvatarError
from ..generator import Generator
from ..training import Gather, Loss, Stage, adamw
from .config import AlignTraining
from .judge import Judge
from .losses import exact_kl
from .policy import GeneratorPolicy, Rollout, Scores, by_layer, check_reference
from .probe import Probe
from .prompts import Prompt, PromptBatch

BatchT = TypeVar("BatchT")
Film = Callable[[GeneratorPolicy, Path], None]
"""Makes samples of a policy in a folder."""


class DivergedError(EchoAvatarError):
    """The policy is further from its reference than it may be; nothing was saved since it was still near."""


class Origin(Config):
    """What else a resumed run must agree in: the reference's weights, the rewards, the pairs."""

    reference: str
    rewards: dict[str, float] = {}
    pairs: str = ""


class Around(NamedTuple):
    """What a run has beside policy, reference and batches; all may be left out."""

    card: Mapping[str, object] = {}
    probe: Probe | None = None
    film: Film | None = None
    rewards: Mapping[str, float] = {}
    reference_name: str = "the reference"
    rollouts: Callable[[GeneratorPolicy], Rollout] | None = None  # a backend in place of the policy's own


BARE = Around()


class PolicyStage(Stage[BatchT]):
    """A policy that learns and the reference it must stay near."""

    config: AlignTraining

    def __init__(
        self,
        generator: Generator,
        reference: Generator,
        training: AlignTraining,
        judge: Judge,
        around: Around = BARE,
        critic: nn.Module | None = None,
    ) -> None:
        """Exemplar control is left as it was.

        Raises:
            CheckpointError: the reference has another vocabulary.
        """
        check_reference(generator, reference, name=around.reference_name)
        for name, parameter in generator.named_parameters():
            parameter.requires_grad_(not name.startswith("exemplar."))
        super().__init__(training, {"model": generator} | ({"critic": critic} if critic is not None else {}))
        self.policy = GeneratorPolicy(generator)
        self.reference = GeneratorPolicy(reference.eval().requires_grad_(False), self.policy.sampling)
        self.judge, self.around = judge, around
        self._far = torch.zeros(2)  # sum of the KL of this process's rows in a step, and how many they are

    @property
    def generator(self) -> Generator:
        """What is tuned."""
        return self.policy.generator

    @property
    def device(self) -> torch.device:
        """Where the policy is."""
        return next(self.generator.parameters()).device

    def identity(self) -> Mapping[str, Config]:
        """Steps may be added to a run; its model, reference and rewards stay."""
        told = Origin(
            reference=fingerprint(self.reference.generator),
            rewards=dict(self.around.rewards),
            pairs=self.compared(),
        )
        training = self.config.model_copy(update={"steps": 1})
        return {"training": training, "generator": self.generator.config, "origin": told}

    def compared(self) -> str:
        """Fingerprint of the data beside the token files, where there is some."""
        return ""

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW over the policy; the reference goes where the policy is."""
        self.reference.generator.to(self.device)
        return [adamw([self.generator], self.config)]

    def clipped(self) -> list[nn.Parameter]:
        """The policy's; a critic may learn as fast as it likes."""
        return list(self.generator.parameters())

    def divergence(
        self, scores: Scores, prompts: PromptBatch, codes: Int[Tensor, "b n p q"]
    ) -> Float[Tensor, "b n k"]:
        """KL of the policy from the reference, exact, over the support that codes were drawn from."""
        with torch.no_grad():
            other = self.reference.score(prompts, codes, scores.support)
        return exact_kl(scores.all_log_probs, other.all_log_probs, scores.support)

    @abstractmethod
    def draw(self, step: int) -> BatchT:
        """See `Stage.draw`."""

    def told(
        self, values: Mapping[str, Tensor], kl: Float[Tensor, "b n k"], scores: Scores
    ) -> dict[str, Tensor | float]:
        """What the log keeps of some rows; the divergence is kept for `after` as well."""
        self._far += torch.tensor([float(kl.detach().mean((1, 2)).sum()), len(kl)])
        entropy = by_layer(scores.entropy, self.policy.layout.motion_layers)
        return dict(values) | {"kl": kl.mean()} | {f"entropy.{at}": one for at, one in enumerate(entropy)}

    @abstractmethod
    def loss(self, batch: BatchT, step: int) -> Loss:
        """See `Stage.loss`."""

    def after(self, step: int, gather: Gather) -> None:
        """Stop a run that runs away.

        Raises:
            DivergedError: the mean divergence of the step's continuations is over `kl_stop`.
        """
        total = gather(self._far.to(self.device)[None]).sum(0)
        self._far = torch.zeros(2)
        if (kl := float(total[0] / total[1])) > self.config.kl_stop:
            raise DivergedError(f"KL {kl:.3f} at step {step + 1} is over kl_stop {self.config.kl_stop}")

    @torch.no_grad()
    def evaluate(self) -> Mapping[str, object]:
        """Rewards, divergence, entropy, FID and beat alignment on held-out prompts, the same ones every time."""
        probe = self.around.probe
        return {} if probe is None else {"held_out": probe(self.policy, self.reference)}

    def save(self, folder: Path, step: int) -> None:
        """The generator, and films of what it makes."""
        told = {"kind": "generator", "step": step, "alignment": self.config.model_dump()}
        self.generator.save(folder, dict(self.around.card) | told)
        if self.around.film is not None:
            self.around.film(self.policy, folder / "samples" / f"step_{step:06d}")


def seeds(training: AlignTraining, number: int, rows: int) -> Int[Tensor, " r"]:
    """Seeds of the continuations of a batch, from the run's seed and the batch's number."""
    random = torch.Generator().manual_seed((training.seed * 1_000_003 + number) * 7)
    return torch.randint(2**62, (rows,), generator=random)


def fingerprint(generator: Generator) -> str:
    """Tells one set of weights from another: a hash of all tensors by name."""
    digest = hashlib.sha256()
    for name, value in sorted(generator.state_dict().items()):
        digest.update(name.encode())
        digest.update(value.detach().float().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def shared_out(prompts: Sequence[Prompt], processes: Any) -> Sequence[Prompt]:
    """Those prompts of a batch that this process answers."""
    each = len(prompts) // processes.count
    return prompts[processes.rank * each : (processes.rank + 1) * each]
