"""The policy: samples motion codes and scores them with the same distribution.

Paper, Reinforcement Learning. A code is sampled from the K logits of its segment, divided by the temperature of its RVQ
layer (temperature x cooling^layer) and cut to the nucleus. Its log-probability is taken from that distribution, not
from the plain softmax:

- temperature and cooling are applied to the logits before anything is computed;
- the nucleus is computed once, under the policy that sampled (`Scores.support`), and kept while the weights change.
  Ratio, entropy and divergence from the reference are those of distributions over that support. If the nucleus were
  recomputed after each step it would change discontinuously, and a sampled code could get probability zero.

A tuned policy must therefore ship with the temperature, cooling and top-p that it was tuned for.

`soup` mixes the weights of runs that began at one generator: start + sum of w (run - start), after Wortsman et al.,
"Model soups" and "Robust fine-tuning of zero-shot models". Runs that began at the same weights lie close enough for
that. Shares that sum to less than 1 take back a part of the tuning, so a soup also trades the gain in reward against
its cost. Not in the paper.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor

from echoavatar.config import Config
from echoavatar.errors import CheckpointError
from echoavatar.models.tokens import TokenLayout
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.generator.sampling import nucleus
from echoavatar_lab.models.generator.sequences import build_sequences, segment_logits
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.progress import Progress

from .prompts import Prompt, PromptBatch, PromptSampler, batch_of

TOGETHER = 8  # prompts sampled at once


class Sampling(Config):
    """How codes are sampled."""

    temperature: float = Field(default=1.0, description="sampling temperature to tune for; saved")
    cooling: float = Field(default=1.0, description="cooling by RVQ layer to tune for; saved")
    top_p: float = Field(default=1.0, description="nucleus to tune for; saved")


class Scores(NamedTuple):
    """Scores of given codes by time step and segment, in grammar order; nats."""

    log_probs: Float[Tensor, "b n k"]
    all_log_probs: Float[Tensor, "b n k K"]  # -inf outside the support
    support: Bool[Tensor, "b n k K"]
    hidden: Float[Tensor, "b n k c"]  # the value head's input

    @property
    def entropy(self) -> Float[Tensor, "b n k"]:
        """Entropy of the distribution over the support."""
        log_probs = self.all_log_probs.masked_fill(~self.support, 0)
        return -(self.all_log_probs.exp() * log_probs).sum(-1)


def exact_kl(
    policy: Float[Tensor, "... K"], reference: Float[Tensor, "... K"], support: Bool[Tensor, "... K"]
) -> Float[Tensor, "..."]:
    """KL(policy || reference) over one support; without sampling noise, because all K logits are known."""
    gap = torch.where(support, policy - reference, 0.0)
    return (policy.exp() * gap).sum(-1)


class Rollout(Protocol):
    """Draws continuations: `GeneratorPolicy.rollout`, or another backend such as an inference server."""

    def __call__(self, prompts: PromptBatch, group: int, seeds: Int[Tensor, " r"]) -> Int[Tensor, "r n p q"]:
        """`group` continuations of every prompt, the rows of a prompt together; one seed for each continuation."""


class GeneratorPolicy:
    """A generator that samples continuations and scores them, with either sequence order, on the generator's device."""

    def __init__(self, generator: Generator, sampling: Sampling | None = None) -> None:
        if sampling is not None:
            generator.config = generator.config.model_copy(update=sampling.model_dump())
        self.generator = generator

    @property
    def layout(self) -> TokenLayout:
        """The vocabulary."""
        return self.generator.config.layout

    @property
    def sampling(self) -> Sampling:
        """The sampling settings; they are saved with the generator."""
        config = self.generator.config
        return Sampling(temperature=config.temperature, cooling=config.cooling, top_p=config.top_p)

    @torch.no_grad()
    def rollout(self, prompts: PromptBatch, group: int, seeds: Int[Tensor, " r"]) -> Int[Tensor, "r n p q"]:
        """`group` continuations of every prompt, the rows of a prompt together; one seed for each continuation.

        Each prompt is read once and its state is copied for the rest of the group. Uses the live decoder: compiled on a
        CPU, plain torch elsewhere.
        """
        stream = open_stream(self.generator)
        rows, heard = len(prompts.past), prompts.past.shape[1] // MOTION_TOKENS_PER_CHUNK
        border = heard * AUDIO_FRAMES_PER_CHUNK
        device = prompts.audio.device
        read, state = stream.init_state(rows), stream.init_state(rows * group)
        active = torch.ones(rows * group, dtype=torch.bool, device=device)
        if heard:
            stream.prime(prompts.audio[:, :border], prompts.past, read, active[:rows])  # type: ignore[arg-type]
        for mine, shared in zip(state.arrays(), read.arrays(), strict=True):
            mine.copy_(shared.repeat_interleave(group, 0))
        sound = prompts.audio[:, border:].repeat_interleave(group, 0)
        return stream.step(sound, state, active, seeds=seeds)  # type: ignore[arg-type]

    def score(
        self,
        prompts: PromptBatch,
        codes: Int[Tensor, "b n p q"],
        support: Bool[Tensor, "b n k K"] | None = None,
        *,
        uses_nucleus: bool = True,
    ) -> Scores:
        """Score continuations. Without `support` it is the nucleus, or everything if not `uses_nucleus`.

        One teacher-forced pass; the order `prefix` needs one for each chunk, because its window slides.
        """
        logits, hidden = self._logits(prompts, codes)
        sampling = self.sampling
        layers = torch.arange(self.layout.segments, device=logits.device) % self.layout.motion_layers
        warmth = sampling.temperature * sampling.cooling ** layers.float()
        logits = logits.float() / warmth[:, None]
        chosen = codes.long().flatten(2)[..., None]
        if support is None:
            support = (
                self._nucleus(logits.detach(), chosen) if uses_nucleus else torch.ones_like(logits, dtype=torch.bool)
            )
        log_probs = torch.log_softmax(logits.masked_fill(~support, -torch.inf), -1)
        return Scores(log_probs.gather(-1, chosen)[..., 0], log_probs, support, hidden)

    def _nucleus(self, logits: Float[Tensor, "b n k K"], chosen: Int[Tensor, "b n k 1"]) -> Bool[Tensor, "b n k K"]:
        """The codes that may be sampled; the sampled code is always included, even where rounding would exclude it."""
        flat = logits.flatten(0, 2)
        top_p = torch.full((len(flat),), self.sampling.top_p, device=flat.device)
        kept = nucleus(flat, top_p).isfinite() if self.sampling.top_p < 1 else torch.ones_like(flat, dtype=torch.bool)
        return kept.view(logits.shape).scatter(-1, chosen, True)

    def _logits(
        self, prompts: PromptBatch, codes: Int[Tensor, "b n p q"]
    ) -> tuple[Float[Tensor, "b n k K"], Float[Tensor, "b n k c"]]:
        """The K logits of every code of the continuations, and the hidden states behind them."""
        motion, steps = torch.cat([prompts.past, codes], 1), codes.shape[1]
        if self.generator.config.sequence != "prefix":
            missing = torch.zeros(len(motion), dtype=torch.int64, device=motion.device)
            return self._read(prompts.audio, motion, missing, steps)
        parts = [
            self._read(*self._window(prompts.audio, motion, end), MOTION_TOKENS_PER_CHUNK)
            for end in range(
                motion.shape[1] - steps + MOTION_TOKENS_PER_CHUNK, motion.shape[1] + 1, MOTION_TOKENS_PER_CHUNK
            )
        ]
        return torch.cat([logits for logits, _ in parts], 1), torch.cat([hidden for _, hidden in parts], 1)

    def _window(self, audio: Tensor, motion: Tensor, end: int) -> tuple[Tensor, Tensor, Tensor]:
        """The window of the order `prefix` that ends before motion token `end`, padded at the front if short."""
        chunks, window = end // MOTION_TOKENS_PER_CHUNK, self.generator.config.window_chunks
        missing = max(0, window - chunks)
        parts = []
        for codes, each in ((audio, AUDIO_FRAMES_PER_CHUNK), (motion, MOTION_TOKENS_PER_CHUNK)):
            seen = codes[:, max(0, chunks - window) * each : chunks * each]
            pad = torch.zeros(len(codes), missing * each, *codes.shape[2:], dtype=codes.dtype, device=codes.device)
            parts.append(torch.cat([pad, seen], 1))
        return parts[0], parts[1], torch.full((len(audio),), missing, device=audio.device)

    def _read(
        self, audio: Tensor, motion: Tensor, missing: Tensor, steps: int
    ) -> tuple[Float[Tensor, "b n k K"], Float[Tensor, "b n k c"]]:
        batch = build_sequences(self.generator.config.order, audio, motion, motion, missing)
        if self.generator.config.sequence == "depth":  # the codes of the past need not be read one by one
            batch = batch.asking(torch.arange(motion.shape[1] - steps, motion.shape[1], device=motion.device))
        hidden = self.generator(batch.ids, batch.valid, asked=batch.asked)
        predictors = batch.predictors[:, -steps:]
        logits = segment_logits(self.generator, hidden, predictors)
        return logits.permute(1, 2, 0, 3), hidden[:, predictors.T]


def continuations(
    policy: GeneratorPolicy,
    book: PromptSampler,
    *,
    prompts: int,
    group: int,
    seed: int,
    progress: Progress | None = None,
) -> Iterator[tuple[list[Prompt], Int[Tensor, "r n p q"]]]:
    """Some prompts at a time of the first `prompts`, and `group` continuations of each, from one seed."""
    for first in range(0, prompts, TOGETHER):
        drawn = book.draw(first // TOGETHER, TOGETHER)[: prompts - first]
        random = torch.Generator().manual_seed(seed * 1_000_003 + first)
        seeds = torch.randint(2**62, (len(drawn) * group,), generator=random)
        yield drawn, policy.rollout(batch_of(drawn), group, seeds)
        if progress is not None:
            progress(first + len(drawn), prompts)


def mean_by_layer(values: Float[Tensor, "b n k"], layers: int) -> list[float]:
    """Mean of each RVQ layer, coarsest first, over rows, time and body parts."""
    split = values.detach().reshape(*values.shape[:2], -1, layers)
    return [float(mean) for mean in split.mean((0, 1, 2))]


def check_reference(policy: Generator, reference: Generator, *, name: str, what: str = "reference") -> None:
    """Refuse a reference whose codes mean something else.

    Raises CheckpointError: its vocabulary, sequence order or code patience differs.
    """
    own, other = policy.config, reference.config
    for key in ("layout", "sequence", "patience"):
        if getattr(own, key) != getattr(other, key):
            raise CheckpointError(
                f"{what} {name} has another {'vocabulary' if key == 'layout' else key}:"
                f" {getattr(other, key)}, the policy's is {getattr(own, key)}; use the generator it was trained from"
            )


@torch.no_grad()
def soup(start: Generator, runs: Mapping[str, tuple[Generator, float]]) -> Generator:
    """A new generator with `start`'s config. `runs` holds each tuned generator and its share, by name.

    Raises CheckpointError: the codes of a run mean something else than `start`'s.
    """
    mixed = Generator(start.config)
    weights = {name: value.clone() for name, value in start.state_dict().items()}
    for run, (tuned, share) in runs.items():
        check_reference(start, tuned, name=run, what="run")
        theirs = tuned.state_dict()
        for name, value in start.state_dict().items():
            weights[name] += share * (theirs[name] - value)
    mixed.load_state_dict(weights)
    return mixed.eval()
