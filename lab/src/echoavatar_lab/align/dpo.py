"""DPO: learns from preferred and rejected continuations of the same prompt (paper, Direct Preference Alignment).

Preference pairs come from people or are ranked by reward, in a JSONL file. A line is one pair: the prompt as clip name
and first chunk of its past, and two continuations as nested lists of codes (motion tokens x parts x layers). The
studio's export and `echoavatar align rollouts` write the same format.
"""

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field, ValidationError
from torch import Tensor

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError, MotionError
from echoavatar.json_reader import read_object
from echoavatar.limits import read_text
from echoavatar.models.tokens import TokenLayout
from echoavatar.timing import MOTION_TOKENS_PER_CHUNK
from echoavatar.whole_file import make_output_folder, write_whole
from echoavatar_lab.training import Loss

from .probe import Judge
from .prompts import Prompt, PromptBatch, PromptSampler, batch_of
from .trainer import PolicyTask

PAIRS_BYTES = 1 << 28  # of a file of pairs; one of 20 chunks takes some 10 KB
Codes = tuple[tuple[tuple[int, ...], ...], ...]


class PreferencePair(Config):
    """One comparison."""

    clip: str = Field(description="name of the token file, without .npz")
    start: int = Field(ge=0, description="chunk at which the prompt's past begins")
    past: int = Field(ge=0, description="chunks of past")
    chosen: Codes = Field(description="codes of the better continuation")
    rejected: Codes = Field(description="codes of the worse one")
    margin: float = Field(default=1.0, description="how much better: reward, or share of raters")
    by: str = Field(default="", description="rater or reward that made the comparison")
    audio: str = Field(default="", description="audio that the raters heard, where people compared")
    model: str = Field(default="", description="bundle that made both continuations")
    seeds: tuple[int, ...] = Field(default=(), description="seeds of chosen and rejected")


def write_pairs(path: Path, pairs: Iterable[PreferencePair]) -> int:
    """Write a file of pairs; returns how many there are."""
    lines = [pair.model_dump_json() for pair in pairs]
    make_output_folder(path.parent)
    write_whole(path, "".join(line + "\n" for line in lines))
    return len(lines)


def read_pairs(
    path: Path, book: PromptSampler, layout: TokenLayout, *, margin: float = 0.0
) -> list[tuple[Prompt, PreferencePair]]:
    """Pairs with their prompts; pairs with a margin below `margin` are skipped.

    Raises MotionError if a line is not a pair, names an unknown clip, or holds codes outside this vocabulary.
    """
    remedy = "make pairs with `echoavatar align rollouts`"
    lines = read_text(path, remedy, largest=PAIRS_BYTES, error=MotionError).splitlines()
    found = []
    for number, line in enumerate(lines, start=1):
        try:
            prompt, pair = _read_pair(line, book, layout)
        except MotionError as error:
            raise MotionError(f"{path}, line {number}: {error}") from error
        if pair.margin >= margin:
            found.append((prompt, pair))
    if not found:
        raise MotionError(f"{path} holds no pair with a margin of at least {margin}; make more, or lower --margin")
    return found


def _read_pair(line: str, book: PromptSampler, layout: TokenLayout) -> tuple[Prompt, PreferencePair]:
    try:
        pair = PreferencePair.model_validate(read_object(line, "it"))
    except EchoAvatarError as error:
        raise MotionError(f"not a pair ({error})") from error
    except ValidationError as error:
        raise MotionError(f"not a pair ({error.errors()[0]['msg']})") from error
    if pair.past != book.past:
        raise MotionError(
            f"the prompt has {pair.past} chunks of past, this run has {book.past}; pass --past {pair.past}"
        )
    prompt = book.cut(pair.clip, pair.start)
    wanted = (len(prompt.truth), layout.parts, layout.motion_layers)
    for name in ("chosen", "rejected"):
        try:
            codes = np.array(getattr(pair, name))
        except ValueError:
            codes = np.zeros(0)
        if codes.shape != wanted or codes.dtype.kind != "i":  # a number beyond 64 bits makes an array of objects
            chunks = wanted[0] // MOTION_TOKENS_PER_CHUNK
            raise MotionError(f"{name} has shape {codes.shape}, expected {wanted} ({chunks} chunks; see --length)")
        if codes.min() < 0 or codes.max() >= layout.motion_codes:
            raise MotionError(f"{name} holds codes outside 0..{layout.motion_codes - 1}: another tokenizer made it")
    return prompt, pair


def rank_pairs(
    prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"], judge: Judge, *, past: int, margin: float = 0.0
) -> list[PreferencePair]:
    """Best and worst of each prompt's continuations by reward; the rows of a prompt follow each other.

    A prompt whose two differ by less than `margin` is skipped.
    """
    total, nested = judge(prompts, codes).total.reshape(len(prompts), -1), codes.tolist()
    pairs = []
    for row, prompt in enumerate(prompts):
        best, worst = int(total[row].argmax()), int(total[row].argmin())
        gap = float(total[row, best] - total[row, worst])
        if gap >= margin and best != worst:
            first = row * total.shape[1]
            pairs.append(
                PreferencePair(
                    clip=prompt.clip,
                    start=prompt.start,
                    past=past,
                    chosen=nested[first + best],
                    rejected=nested[first + worst],
                    margin=gap,
                    by="reward",
                )
            )
    return pairs


class DpoLoss(NamedTuple):
    """The loss and its diagnostics."""

    loss: Float[Tensor, ""]
    margin: Float[Tensor, ""]  # of the implicit rewards, chosen over rejected
    accuracy: Float[Tensor, ""]  # share of pairs with a positive margin


def dpo_loss(
    *,
    chosen: Float[Tensor, " b"],
    rejected: Float[Tensor, " b"],
    reference_chosen: Float[Tensor, " b"],
    reference_rejected: Float[Tensor, " b"],
    beta: float,
) -> DpoLoss:
    """Direct preference loss (paper, equation DPO) from log-probabilities summed over each continuation."""
    margin = beta * ((chosen - reference_chosen) - (rejected - reference_rejected))
    return DpoLoss(-F.logsigmoid(margin).mean(), margin.mean(), (margin > 0).float().mean())


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
        written = "".join(pair.model_dump_json() for _, pair in self._pairs)
        self.data_fingerprint = hashlib.sha256(written.encode()).hexdigest()

    def draw(self, step: int) -> PairBatch:
        """The pairs of a step."""
        prompts, pairs = zip(*(self._pairs[at] for at in self.order(step)), strict=True)
        chosen, rejected = (torch.tensor([getattr(pair, name) for pair in pairs]) for name in ("chosen", "rejected"))
        return PairBatch(batch_of(prompts), chosen, rejected)

    def loss(self, batch: PairBatch, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        both = (batch.chosen, batch.rejected)
        own = [self.policy.score(batch.prompts, part, uses_nucleus=False) for part in both]
        with torch.no_grad():
            other = [self.reference.score(batch.prompts, part, uses_nucleus=False) for part in both]
        kl = self.divergence(own[0], batch.prompts, batch.chosen)
        chosen, rejected, *reference = (scores.log_probs.sum((1, 2)) for scores in (*own, *other))
        found = dpo_loss(
            chosen=chosen,
            rejected=rejected,
            reference_chosen=reference[0],
            reference_rejected=reference[1],
            beta=self.config.beta,
        )
        logged = {"margin": found.margin, "accuracy": found.accuracy}
        return Loss(found.loss, self.logged(logged, kl, own[0]))

    def order(self, step: int) -> list[int]:
        """Indices of a step's pairs: every pass is a new permutation; a batch may span two passes."""
        batch, count = self.config.batch, len(self._pairs)
        at = np.arange(step * batch, (step + 1) * batch)
        passes = np.unique(at // count)
        orders = [np.random.default_rng([self.config.seed, int(number)]).permutation(count) for number in passes]
        found: list[int] = np.concatenate(orders)[at - passes[0] * count].tolist()
        return found
