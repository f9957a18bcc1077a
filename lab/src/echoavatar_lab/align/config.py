"""Settings of reinforcement learning and its three recipes: tiny (tests), rehearsal (the default bundle), paper."""

from typing import Literal, Self

from pydantic import Field, model_validator

from echoavatar_lab.training import Schedule, TrainingConfig

from .prompts import Events

Method = Literal["grpo", "dpo", "ppo"]
NEVER = 1e6  # no KL is so large


class AlignTraining(TrainingConfig):
    """How a policy is tuned. The defaults are the rehearsal recipe's.

    `batch` counts prompts (DPO: pairs); each prompt is continued `group` times.
    """

    method: Method = Field(default="grpo", description="grpo, dpo or ppo")
    steps: int = Field(default=200, gt=0, description="optimiser steps")
    batch: int = Field(default=4, gt=0, description="prompts, or pairs, a step (paper: 16)")
    accumulation: int = Field(
        default=1, gt=0, description="pieces that a batch is split into; changes memory, not the result"
    )
    group: int = Field(
        default=8, gt=0, description="continuations of each prompt (paper: GRPO 30, PPO 1, pairs for DPO 8)"
    )
    past: int = Field(default=3, ge=0, description="chunks of true motion and audio before a continuation")
    own_past: int = Field(
        default=0, ge=0, description="chunks of the past that the policy makes itself, as in a session (paper: none)"
    )
    length: int = Field(default=9, gt=0, description="chunks of a continuation (paper: 15, 4 s)")
    fewest_events: int = Field(
        default=2, ge=0, description="beats or stressed syllables that a prompt's audio must contain"
    )
    events: Events = Field(default="any", description="which events count: any, beat (music) or stress (speech)")
    learning_rate: float = Field(default=1e-4, gt=0, description="AdamW (paper: 6e-5 at 0.5B)")
    schedule: Schedule = Field(
        default="constant", description="learning rate schedule; a constant one lets a run be extended"
    )
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
    """The settings of a recipe (`tiny`, `rehearsal` or `paper`) for a method."""
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
            # the paper's windows last 4 s; it does not say how much of them is context, so ours have none
            sizes = {"batch": 16, "group": {"grpo": 30, "dpo": 8, "ppo": 1}[method], "past": 0, "length": 15}
            sizes |= {"learning_rate": 6e-5, "credit": "sequence", "discount": 1.0, "fewest_events": 0}
            sizes |= {"kl_stop": NEVER}
            sizes |= {"accumulation": {"grpo": 16, "dpo": 2, "ppo": 1}[method]}
        case _:
            raise ValueError(f"no recipe {name!r}: tiny, rehearsal or paper")
    return AlignTraining.model_validate({"method": method} | sizes)
