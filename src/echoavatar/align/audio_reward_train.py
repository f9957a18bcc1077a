"""Training the alignment reward on token clips, and testing it by retrieval among held-out windows."""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor

from ..config import Config
from ..errors import MotionError
from ..generator import TokenClip
from ..metrics.retrieval import PAPER_GALLERY, Retrieval, batched, chance, gallery, retrieval, similarity
from ..timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK
from .audio_reward import AudioMotion, info_nce

WINDOW_CHUNKS = 15  # 4 s
MIRROR = ".mirror"  # ending of the name of a mirrored clip (`pipeline.tokenize`)


class AudioRewardTraining(Config):
    """How the reward is trained."""

    steps: int = Field(default=2000, gt=0, description="optimiser steps")
    batch: int = Field(default=64, gt=0, description="windows a step (paper: 32)")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak, cosine (paper: 1e-4)")
    weight_decay: float = Field(default=0.05, ge=0, description="AdamW decay")
    seed: int = Field(default=0, description="of weights and windows")


class Pairs:
    """Windows of sound and motion; windows of one segment, mirrored ones too, have the same number."""

    def __init__(self, clips: Mapping[str, TokenClip], *, chunks: int = WINDOW_CHUNKS) -> None:
        self._chunks = chunks
        sources = sorted({name.removesuffix(MIRROR) for name in clips})
        self._source = {name: at for at, name in enumerate(sources)}
        self._clips = {name: clip for name, clip in clips.items() if clip.chunks >= chunks}
        if not self._clips:
            raise MotionError(f"no clip is as long as a window of {chunks} chunks")
        self._names = list(self._clips)

    def draw(self, number: int, size: int, seed: int) -> tuple[Tensor, Tensor, Int[Tensor, " b"]]:
        """Sound, motion and segment of so many random windows."""
        random = np.random.default_rng([seed, number])
        spots = []
        for at in random.integers(len(self._names), size=size):
            name = self._names[int(at)]
            spots.append((name, int(random.integers(self._clips[name].chunks - self._chunks + 1))))
        return self._cut(spots)

    def grid(self) -> tuple[Tensor, Tensor]:
        """All windows without overlap, mirrored ones left out."""
        spots = [
            (name, start)
            for name, clip in self._clips.items()
            if not name.endswith(MIRROR)
            for start in range(0, clip.chunks - self._chunks + 1, self._chunks)
        ]
        sound, motion, _ = self._cut(spots)
        return sound, motion

    def _cut(self, spots: Sequence[tuple[str, int]]) -> tuple[Tensor, Tensor, Int[Tensor, " b"]]:
        def stacked(field: str, each: int) -> Tensor:
            parts = [
                getattr(self._clips[name], field)[start * each : (start + self._chunks) * each]
                for name, start in spots
            ]
            return torch.from_numpy(np.stack(parts).astype(np.int64))

        segments = [self._source[name.removesuffix(MIRROR)] * 100_000 + start for name, start in spots]
        return (
            stacked("audio", AUDIO_FRAMES_PER_CHUNK),
            stacked("motion", MOTION_TOKENS_PER_CHUNK),
            torch.tensor(segments),
        )


def train_audio_reward(
    model: AudioMotion,
    pairs: Pairs,
    folder: Path,
    training: AudioRewardTraining,
    *,
    card: Mapping[str, object] | None = None,
    minutes: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> AudioMotion:
    """Train and write a checkpoint folder; with `minutes` the schedule follows the clock as well."""
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=training.learning_rate, weight_decay=training.weight_decay
    )
    folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    model.train()
    with (folder / "metrics.jsonl").open("w") as out:
        for step in range(training.steps):
            share = max(
                step / training.steps, 0 if minutes is None else (time.monotonic() - began) / 60 / minutes
            )
            if share >= 1:
                break
            for group in optimiser.param_groups:
                rate = training.learning_rate * 0.5 * (1 + math.cos(math.pi * share))
                group["lr"] = rate * min(1.0, (step + 1) / 50)
            sound, motion, segments = pairs.draw(step, training.batch, training.seed)
            loss = info_nce(model.hear(sound), model.see(motion), model.temperature, segments)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            told = {
                "step": step,
                "loss": round(loss.item(), 5),
                "temperature": round(model.temperature.item(), 3),
            }
            out.write(json.dumps(told) + "\n")
            out.flush()
            if progress is not None:
                progress(step + 1, training.steps)
    model.save(folder, dict(card or {}) | {"kind": "audio_reward", "training": training.model_dump()})
    return model.eval()


@torch.no_grad()
def embed(model: AudioMotion, pairs: Pairs) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d"]]:
    """Embeddings of all windows without overlap."""
    sound, motion = pairs.grid()
    heard = torch.cat([model.hear(part) for part in torch.split(sound, 64)])
    seen = torch.cat([model.see(part) for part in torch.split(motion, 64)])
    return heard.numpy(), seen.numpy()


def retrieval_table(
    sounds: Float[np.ndarray, "n d"], motions: Float[np.ndarray, "n d"]
) -> dict[str, dict[str, object]]:
    """The paper's table: both ways, among all, in one gallery of 300, in TMR's batches of 32; and chance for each."""
    table = {}
    for way, matrix in (
        ("audio to motion", similarity(sounds, motions)),
        ("motion to audio", similarity(motions, sounds)),
    ):
        found = {"all": retrieval(matrix), "gallery": gallery(matrix, PAPER_GALLERY)}
        if len(matrix) >= 32:
            found["batches"] = batched(matrix)
        for protocol, scores in found.items():
            table[f"{way}, {protocol}"] = _row(scores) | {"chance": _row(chance(scores.gallery))}
    return table


def _row(scores: Retrieval) -> dict[str, object]:
    recall: dict[str, object] = {f"R@{k}": round(value, 3) for k, value in scores.recall.items()}
    return recall | {
        "MedR": scores.median_rank,
        "MRR": round(scores.reciprocal_rank, 3),
        "gallery": scores.gallery,
    }
