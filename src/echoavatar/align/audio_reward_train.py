"""Training the alignment reward on token clips, and testing it by retrieval among held-out windows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor

from ..audio import AudioCodec
from ..config import Config
from ..errors import MotionError
from ..generator import TokenClip
from ..metrics.retrieval import PAPER_GALLERY, Retrieval, batched, chance, gallery, retrieval, similarity
from ..timing import AUDIO_FRAMES_PER_CHUNK, CHUNK_SECONDS, MOTION_TOKENS_PER_CHUNK, exact_div
from ..training import Loss, Progress, Stage, TrainingConfig, train
from .audio_reward import WINDOW_TOKENS, AudioMotion, info_nce
from .ears import wave_of
from .fbank import RATE_HZ

WINDOW_CHUNKS = exact_div(WINDOW_TOKENS, MOTION_TOKENS_PER_CHUNK)
DOMAINS = ("silence", "speech", "music")
FEWEST = 32  # windows of a domain, for a table of its own
MIRROR = ".mirror"  # ending of the name of a mirrored clip (`pipeline.tokenize`)


class AudioRewardTraining(TrainingConfig):
    """How the reward is trained. Negatives are those of one piece: several processes want larger batches."""

    steps: int = Field(default=1000, gt=0, description="optimiser steps")
    batch: int = Field(default=64, gt=0, description="windows a step (paper: 32)")
    each: int = Field(default=4, gt=0, description="windows of one clip in a batch, which do not overlap")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak, cosine (paper: 1e-4)")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(default=0.0, ge=0, le=1, description="share of the peak at the end")
    weight_decay: float = Field(default=0.05, ge=0, description="AdamW decay")
    save_every: int = Field(default=50, ge=0, description="steps between checkpoints")


class Windows(NamedTuple):
    """Sound, motion, and the number of the segment, the same for mirrored motion."""

    sound: Tensor  # codes, or a waveform at 16 kHz
    motion: Tensor
    segments: Int[Tensor, " b"]


class Pairs:
    """Windows of sound and motion; windows of one segment, mirrored ones too, have the same number."""

    def __init__(
        self,
        clips: Mapping[str, TokenClip],
        *,
        chunks: int = WINDOW_CHUNKS,
        waves: Mapping[str, Tensor] | None = None,
    ) -> None:
        """With `waves` (`waves_of`) sound is waveforms, else codes."""
        self._chunks, self._waves = chunks, waves
        sources = sorted({name.removesuffix(MIRROR) for name in clips})
        self._source = {name: at for at, name in enumerate(sources)}
        self._clips = {name: clip for name, clip in clips.items() if clip.chunks >= chunks}
        if not self._clips:
            raise MotionError(f"no clip is as long as a window of {chunks} chunks")
        self._names = list(self._clips)

    def draw(self, number: int, size: int, seed: int, *, each: int = 1) -> Windows:
        """So many random windows, `each` of a clip: other moments of the same sound are the hardest to tell apart."""
        random, spots = np.random.default_rng([seed, number]), list[tuple[str, int]]()
        while len(spots) < size:
            name = self._names[int(random.integers(len(self._names)))]
            room = self._clips[name].chunks - self._chunks
            first = int(random.integers(min(self._chunks, room + 1)))
            starts = np.arange(first, room + 1, self._chunks)
            spots += [(name, int(start)) for start in random.permutation(starts)[:each]]
        return self._cut(spots[:size])

    def grid(self, sound: int | None = None) -> Windows:
        """All windows without overlap, mirrored ones left out; of mostly one domain, where one is given."""
        spots = [
            (name, start)
            for name, clip in self._clips.items()
            if not name.endswith(MIRROR)
            for start in range(0, clip.chunks - self._chunks + 1, self._chunks)
            if sound is None or self._domain(name, start) == sound
        ]
        if not spots:
            raise MotionError(f"no window of {self._chunks} chunks is mostly {DOMAINS[sound or 0]}")
        return self._cut(spots)

    def _domain(self, name: str, start: int) -> int:
        """What fills most of a window."""
        span = slice(start * MOTION_TOKENS_PER_CHUNK, (start + self._chunks) * MOTION_TOKENS_PER_CHUNK)
        return int(np.bincount(self._clips[name].domain[span], minlength=len(DOMAINS)).argmax())

    def _cut(self, spots: Sequence[tuple[str, int]]) -> Windows:
        def stacked(field: str, each: int) -> Tensor:
            parts = [
                getattr(self._clips[name], field)[start * each : (start + self._chunks) * each]
                for name, start in spots
            ]
            return torch.from_numpy(np.stack(parts).astype(np.int64))

        sound = stacked("audio", AUDIO_FRAMES_PER_CHUNK) if self._waves is None else self._heard(spots)
        segments = [self._source[name.removesuffix(MIRROR)] * 100_000 + start for name, start in spots]
        return Windows(
            sound,
            stacked("motion", MOTION_TOKENS_PER_CHUNK),
            torch.tensor(segments),
        )

    def _heard(self, spots: Sequence[tuple[str, int]]) -> Float[Tensor, "b s"]:
        """Windows of the waveforms."""
        assert self._waves is not None
        samples = int(self._chunks * CHUNK_SECONDS * RATE_HZ)  # a chunk is no whole number of them
        firsts = [(name, int(start * CHUNK_SECONDS * RATE_HZ)) for name, start in spots]
        rows = [self._waves[name.removesuffix(MIRROR)][first : first + samples] for name, first in firsts]
        return torch.stack(rows).float()


def waves_of(
    codec: AudioCodec, clips: Mapping[str, TokenClip], progress: Progress | None = None
) -> dict[str, Float[Tensor, " s"]]:
    """What the codec makes of the clips' codes, at 16 kHz in half precision, by name; mirrored ones share theirs."""
    sources = {name.removesuffix(MIRROR): clip for name, clip in clips.items()}
    waves = {}
    for done, (name, clip) in enumerate(sources.items(), start=1):
        waves[name] = wave_of(codec, torch.from_numpy(clip.audio.astype(np.int64))[None])[0].half()
        if progress is not None:
            progress(done, len(sources))
    return waves


class AudioRewardStage(Stage[Windows]):
    """The two encoders and the pairs they learn."""

    config: AudioRewardTraining

    def __init__(
        self,
        model: AudioMotion,
        pairs: Pairs,
        training: AudioRewardTraining,
        card: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(training, {"model": model})
        self.model, self._pairs, self._card = model, pairs, dict(card or {})

    def identity(self) -> Mapping[str, Config]:
        """Sizes and schedule."""
        return {"reward": self.model.config, "training": self.config}

    def draw(self, step: int) -> Windows:
        """See `Stage.draw`."""
        return self._pairs.draw(step, self.config.batch, self.config.seed, each=self.config.each)

    def loss(self, batch: Windows, step: int) -> Loss:
        """See `Stage.loss`."""
        model = self.model
        found = info_nce(model.hear(batch.sound), model.see(batch.motion), model.temperature, batch.segments)
        return Loss(found, {"temperature": model.temperature})

    def save(self, folder: Path, step: int) -> None:
        """The reward."""
        about = {"kind": "audio_reward", "step": step, "training": self.config.model_dump()}
        self.model.save(folder, self._card | about)


def train_audio_reward(
    model: AudioMotion,
    pairs: Pairs,
    folder: Path,
    training: AudioRewardTraining,
    *,
    card: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> AudioMotion:
    """Train into a checkpoint folder, going on with what is there."""
    train(AudioRewardStage(model, pairs, training, card), folder, progress=progress)
    return model.eval()


@torch.no_grad()
def embed(
    model: AudioMotion, pairs: Pairs, sound: int | None = None
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d"]]:
    """Embeddings of all windows without overlap, or of those of mostly one domain."""
    asked = pairs.grid(sound)
    heard = torch.cat([model.hear(part) for part in torch.split(asked.sound, 64)])
    seen = torch.cat([model.see(part) for part in torch.split(asked.motion, 64)])
    return heard.numpy(), seen.numpy()


def retrieval_tables(model: AudioMotion, pairs: Pairs) -> dict[str, dict[str, dict[str, object]]]:
    """`retrieval_table` of everything, and within each domain alone, where telling domains apart does not help."""
    tables = {"everything": retrieval_table(*embed(model, pairs))}
    for at, name in enumerate(DOMAINS):
        try:
            found = embed(model, pairs, at)
        except MotionError:  # none of it
            continue
        if len(found[0]) >= FEWEST:
            tables[name] = retrieval_table(*found)
    return tables


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
