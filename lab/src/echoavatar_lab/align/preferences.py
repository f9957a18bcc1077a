"""Preference pairs in a JSONL file, from people or ranked by reward (paper, Direct Preference Alignment).

A line is one pair: the prompt as clip name and first chunk of its past, and two continuations as nested lists of codes
(motion tokens x parts x layers). The studio's export and `echoavatar align rollouts` write the same format.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from pydantic import Field, ValidationError

from echoavatar.config import Config
from echoavatar.errors import MotionError
from echoavatar.models.tokens import TokenLayout
from echoavatar.timing import MOTION_TOKENS_PER_CHUNK

from .judge import Judge
from .policy import GeneratorPolicy
from .prompts import Prompt, PromptSampler, batch_of

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
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(line + "\n" for line in lines), encoding="utf-8")
    return len(lines)


def read_pairs(
    path: Path, book: PromptSampler, layout: TokenLayout, *, margin: float = 0.0
) -> list[tuple[Prompt, PreferencePair]]:
    """Pairs with their prompts; pairs with a margin below `margin` are skipped.

    Raises:
        MotionError: a line is not a pair, names an unknown clip, or holds codes outside this vocabulary.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise MotionError(
            f"{path} cannot be read ({error.strerror}); make pairs with `echoavatar align rollouts`"
        ) from error
    found = []
    for number, line in enumerate(lines, start=1):
        try:
            pair = PreferencePair.model_validate(json.loads(line))
        except (ValueError, ValidationError) as error:
            first = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
            raise MotionError(f"{path}, line {number}: not a pair ({first})") from error
        if pair.past != book.past:
            raise MotionError(
                f"{path}, line {number}: the prompt has {pair.past} chunks of past, this run has {book.past};"
                f" pass --past {pair.past}"
            )
        try:
            prompt = book.cut(pair.clip, pair.start)
            _check(pair, prompt, layout)
        except MotionError as error:
            raise MotionError(f"{path}, line {number}: {error}") from error
        if pair.margin >= margin:
            found.append((prompt, pair))
    if not found:
        raise MotionError(f"{path} holds no pair with a margin of at least {margin}; make more, or lower --margin")
    return found


def _check(pair: PreferencePair, prompt: Prompt, layout: TokenLayout) -> None:
    wanted = (len(prompt.truth), layout.parts, layout.motion_layers)
    for name in ("chosen", "rejected"):
        try:
            codes = np.array(getattr(pair, name))
        except ValueError:
            codes = np.zeros(0)
        if codes.shape != wanted:
            chunks = wanted[0] // MOTION_TOKENS_PER_CHUNK
            raise MotionError(f"{name} has shape {codes.shape}, expected {wanted} ({chunks} chunks; see --length)")
        if codes.min() < 0 or codes.max() >= layout.motion_codes:
            raise MotionError(f"{name} holds codes outside 0..{layout.motion_codes - 1}: another tokenizer made it")


def _nested(codes: Int[torch.Tensor, "n p q"]) -> Codes:
    return tuple(tuple(tuple(int(code) for code in part) for part in step) for step in codes)


def codes_of(pairs: Sequence[PreferencePair], name: str) -> Int[torch.Tensor, "b n p q"]:
    """The `chosen` or `rejected` codes of pairs as a tensor."""
    return torch.tensor([getattr(pair, name) for pair in pairs])


def rank_pairs(
    policy: GeneratorPolicy,
    prompts: Sequence[Prompt],
    judge: Judge,
    *,
    past: int,
    group: int = 8,
    margin: float = 0.0,
    seed: int = 0,
) -> list[PreferencePair]:
    """Best and worst of `group` continuations by reward; a prompt whose two differ by less than `margin` is skipped."""
    random = torch.Generator().manual_seed(seed)
    seeds = torch.randint(2**62, (len(prompts) * group,), generator=random)
    codes = policy.rollout(batch_of(prompts), group, seeds)
    total = judge(prompts, codes).total.reshape(len(prompts), group)
    pairs = []
    for row, prompt in enumerate(prompts):
        best, worst = int(total[row].argmax()), int(total[row].argmin())
        gap = float(total[row, best] - total[row, worst])
        if gap >= margin and best != worst:
            chosen, rejected = (_nested(codes[row * group + at]) for at in (best, worst))
            pairs.append(
                PreferencePair(
                    clip=prompt.clip,
                    start=prompt.start,
                    past=past,
                    chosen=chosen,
                    rejected=rejected,
                    margin=gap,
                    by="reward",
                )
            )
    return pairs
