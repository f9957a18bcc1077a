"""Small policies with a task whose best answer is known: say code 3 everywhere."""

import copy
from pathlib import Path

import numpy as np
import torch
from tests.models.generator.tiny import generator

from echoavatar_lab.align.dpo import DpoTask, rank_pairs
from echoavatar_lab.align.policy import GeneratorPolicy, continuations
from echoavatar_lab.align.prompts import PromptSampler
from echoavatar_lab.align.rewards import Rewards
from echoavatar_lab.align.rollouts import GrpoTask, PpoTask
from echoavatar_lab.align.trainer import NO_CONTEXT, AlignTraining, RunContext
from echoavatar_lab.models.generator.windows import TokenClip

WANTED = 3


def clips(count: int = 3, chunks: int = 6) -> dict[str, TokenClip]:
    random = np.random.default_rng(0)
    cues = np.zeros((20 * chunks, 2), np.uint8)
    cues[30::37, 0] = cues[31::37, 0] = 1
    return {
        f"clip{k}": TokenClip(
            random.integers(16, size=(20 * chunks, 2)),
            random.integers(8, size=(2 * chunks, 3, 2)),
            np.full(2 * chunks, 2, np.uint8),
            cues=cues,
        )
        for k in range(count)
    }


def save_clips(folder: Path, count: int, chunks: int, *, held_out: bool = False) -> Path:
    """Write token files; with `held_out` the last one is for testing."""
    folder.mkdir()
    for at, (name, clip) in enumerate(clips(count, chunks).items()):
        object.__setattr__(clip, "split", "test" if held_out and at == count - 1 else "train")
        clip.save(folder / f"{name}.npz")
    return folder


def book(past: int = 1, length: int = 1) -> PromptSampler:
    return PromptSampler(clips(), past=past, length=length)


def wants_threes(prompts, codes: torch.Tensor) -> Rewards:
    """The fraction of codes that are 3, by motion token (their sum is the fraction of all)."""
    tokens = (codes == WANTED).double().mean((2, 3)).numpy() / codes.shape[1]
    return Rewards(tokens, np.zeros(len(codes)), {"threes": tokens.sum(1)})


def policy(sequence: str = "interleaved"):
    """Quiet enough to begin with nearly uniform codes."""
    model = generator(sequence=sequence)
    with torch.no_grad():
        model.lm_head.weight.mul_(0.2)
    return model


def training(method: str, **changes) -> AlignTraining:
    sizes = {
        "method": method, "steps": 60, "batch": 2, "group": 8, "past": 1, "length": 1, "fewest_events": 0,
        "learning_rate": 3e-2, "warmup": 1, "kl_weight": 0.0, "kl_stop": 100.0, "probe": 4, "evaluate_every": 1000,
        "save_every": 1000, "critic_rate": 1e-2,
    }  # fmt: skip
    return AlignTraining.model_validate(sizes | changes)


def grpo(context: RunContext = NO_CONTEXT, prompts: PromptSampler | None = None, **changes) -> GrpoTask:
    settings = training("grpo", **changes)
    return GrpoTask(policy(), policy(), settings, wants_threes, context, book=prompts or book())


def ppo(context: RunContext = NO_CONTEXT, **changes) -> PpoTask:
    return PpoTask(policy(), policy(), training("ppo", **changes), wants_threes, context, book=book())


def dpo(context: RunContext = NO_CONTEXT, model=None, prompts: int = 12, **changes) -> DpoTask:
    model = model or policy()
    settings = training("dpo", **changes)
    return DpoTask(model, copy.deepcopy(model), settings, wants_threes, context, pairs=ranked_pairs(prompts, model))


def ranked_pairs(prompts: int, model):
    mine = book()
    made = continuations(GeneratorPolicy(model), mine, prompts=prompts, group=8, seed=0)
    pairs = [pair for drawn, codes in made for pair in rank_pairs(drawn, codes, wants_threes, past=1)]
    return [(mine.cut(pair.clip, pair.start), pair) for pair in pairs]
