"""Trains the audio-motion alignment reward on token clips and tests it by retrieval among held-out windows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor

from echoavatar.errors import MotionError
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, CHUNK_FRAMES, CHUNK_SECONDS, MOTION_TOKENS_PER_CHUNK, exact_div
from echoavatar_lab.data import DOMAINS
from echoavatar_lab.evaluation.metrics.retrieval import Retrieval, batched, chance, gallery, retrieval, similarity
from echoavatar_lab.foreign.foreign_files import read_tensors
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.windows import TokenClip
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.progress import Progress, watched
from echoavatar_lab.training import Loss, TrainingConfig, TrainingTask, seeded

from .audio_encoders import RATE_HZ, SMALL_BEATS, SMALL_WAV2CLIP, Beats, Wav2Clip, decoded_waveform
from .audio_reward import WINDOW_TOKENS, AudioMotion, info_nce

WINDOW_CHUNKS = exact_div(WINDOW_TOKENS, MOTION_TOKENS_PER_CHUNK)
FEWEST = 32  # windows that a domain needs for a table of its own
MIRROR = ".mirror"  # suffix of a mirrored clip's name (`pipeline.tokenize`)


class AudioRewardTraining(TrainingConfig):
    """Training settings. With several processes negatives come from the process's own rows, so use a larger batch."""

    steps: int = Field(default=1000, gt=0, description="optimiser steps")
    batch: int = Field(default=64, gt=0, description="windows a step (paper: 32)")
    each: int = Field(default=4, gt=0, description="windows of one clip in a batch; they do not overlap")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak, cosine (paper: 1e-4)")
    warmup: int = Field(default=50, ge=0, description="steps of linear warm-up")
    final_rate: float = Field(default=0.0, ge=0, le=1, description="share of the peak at the end")
    weight_decay: float = Field(default=0.05, ge=0, description="AdamW decay")
    save_every: int = Field(default=50, ge=0, description="steps between checkpoints")


def untrained(
    codec: AudioCodec,
    tokenizer: BodyTokenizer,
    *,
    encoder: str,
    weights: Path | None = None,
    motion: str = "codes",
    seed: int = 0,
    **sizes: int,
) -> AudioMotion:
    """The reward before training; `encoder` is one of `audio_encoders.KINDS`, `motion` what it reads.

    Published `weights` of BEATs or Wav2CLIP are kept fixed; without them a small network of that kind learns along.
    Raises CheckpointError if the file holds other weights.
    """
    read = tokenizer.statistics if motion == "features" else None
    with seeded(seed):
        book = tokenizer.codebooks().detach()
        if encoder == "codes":
            return AudioMotion.from_codebooks(codec.codebooks.detach(), book, statistics=read, **sizes)
        network: Beats | Wav2Clip
        if encoder == "beats":
            network = Beats.from_published(read_tensors(weights, "model")) if weights else Beats(SMALL_BEATS)
        elif weights:
            network = Wav2Clip.from_published(read_tensors(weights, "state_dict"))
        else:
            network = Wav2Clip(SMALL_WAV2CLIP)
        return AudioMotion.from_network(network, codec, book, is_frozen=weights is not None, statistics=read, **sizes)


class Windows(NamedTuple):
    """Audio, motion, and a segment number that mirrored motion shares with its original."""

    sound: Tensor  # codec tokens, or a waveform at 16 kHz
    motion: Tensor
    segments: Int[Tensor, " b"]


class AudioMotionWindows:
    """Windows of audio and motion cut from clips; windows of one segment, mirrored ones too, share a number."""

    def __init__(
        self,
        clips: Mapping[str, TokenClip],
        *,
        chunks: int = WINDOW_CHUNKS,
        waves: Mapping[str, Tensor] | None = None,
        features: Mapping[str, Tensor] | None = None,
    ) -> None:
        """With `waves` (from `decoded_waveforms`) the audio is a waveform, otherwise codec tokens.

        With `features` (from `decoded_features`) the motion is features at 30 fps, otherwise codes.
        """
        self._chunks, self._waves, self._features = chunks, waves, features
        sources = sorted({name.removesuffix(MIRROR) for name in clips})
        self._source = {name: at for at, name in enumerate(sources)}
        self._clips = {name: clip for name, clip in clips.items() if clip.chunks >= chunks}
        if not self._clips:
            raise MotionError(f"no clip is as long as a window of {chunks} chunks")
        self._names = list(self._clips)

    def draw(self, number: int, size: int, seed: int, *, each: int = 1) -> Windows:
        """`size` random windows, `each` from one clip: other moments of the same clip are the hardest negatives."""
        random, spots = np.random.default_rng([seed, number]), list[tuple[str, int]]()
        while len(spots) < size:
            name = self._names[int(random.integers(len(self._names)))]
            room = self._clips[name].chunks - self._chunks
            first = int(random.integers(min(self._chunks, room + 1)))
            starts = np.arange(first, room + 1, self._chunks)
            spots += [(name, int(start)) for start in random.permutation(starts)[:each]]
        return self._cut(spots[:size])

    def grid(self, sound: int | None = None) -> Windows:
        """All non-overlapping windows of clips that are not mirrored, or only those mostly of domain `sound`."""
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
        """The domain of most of a window's tokens."""
        span = slice(start * MOTION_TOKENS_PER_CHUNK, (start + self._chunks) * MOTION_TOKENS_PER_CHUNK)
        return int(np.bincount(self._clips[name].domain[span], minlength=len(DOMAINS)).argmax())

    def _cut(self, spots: Sequence[tuple[str, int]]) -> Windows:
        chunks = self._chunks

        def codes(field: str, each: int) -> list[Tensor]:
            found = [getattr(self._clips[name], field)[start * each : (start + chunks) * each] for name, start in spots]
            return [torch.from_numpy(one.astype(np.int64)) for one in found]

        if self._waves is None:
            sound = codes("audio", AUDIO_FRAMES_PER_CHUNK)
        else:
            samples = int(chunks * CHUNK_SECONDS * RATE_HZ)  # a chunk is not a whole number of samples
            firsts = [(name.removesuffix(MIRROR), int(start * CHUNK_SECONDS * RATE_HZ)) for name, start in spots]
            sound = [self._waves[name][first : first + samples].float() for name, first in firsts]
        if self._features is None:
            motion = codes("motion", MOTION_TOKENS_PER_CHUNK)
        else:
            frames = [(name, slice(start * CHUNK_FRAMES, (start + chunks) * CHUNK_FRAMES)) for name, start in spots]
            motion = [self._features[name][span].float() for name, span in frames]
        segments = [self._source[name.removesuffix(MIRROR)] * 100_000 + start for name, start in spots]
        return Windows(torch.stack(sound), torch.stack(motion), torch.tensor(segments))


def decoded_waveforms(
    codec: AudioCodec, clips: Mapping[str, TokenClip], progress: Progress | None = None
) -> dict[str, Float[Tensor, " _"]]:
    """Decode each clip's codec tokens to a 16 kHz waveform in half precision, by name; mirrored clips share one."""
    sources = {name.removesuffix(MIRROR): clip for name, clip in clips.items()}
    waves = {}
    for name, clip in watched(list(sources.items()), progress):
        waves[name] = decoded_waveform(codec, torch.from_numpy(clip.audio.astype(np.int64))[None])[0].half()
    return waves


@torch.no_grad()
def decoded_features(
    tokenizer: BodyTokenizer, clips: Mapping[str, TokenClip], progress: Progress | None = None
) -> dict[str, Float[Tensor, "_ c"]]:
    """Decode each clip's motion codes to features in half precision, by name, as continuations are judged."""
    found = {}
    for name, clip in watched(list(clips.items()), progress):
        found[name] = tokenizer.decode(torch.from_numpy(clip.motion.astype(np.int64))[None])[0].half()
    return found


class AudioRewardTask(TrainingTask[Windows]):
    """The training task of the alignment reward."""

    kind = "audio_reward"
    config: AudioRewardTraining

    def __init__(
        self,
        model: AudioMotion,
        pairs: AudioMotionWindows,
        training: AudioRewardTraining,
        card: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(training, {"model": model}, card)
        self.model, self._pairs = model, pairs

    def draw(self, step: int) -> Windows:
        """See `TrainingTask.draw`."""
        return self._pairs.draw(step, self.config.batch, self.config.seed, each=self.config.each)

    def loss(self, batch: Windows, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        model = self.model
        found = info_nce(
            model.embed_audio(batch.sound), model.embed_motion(batch.motion), model.temperature, batch.segments
        )
        return Loss(found, {"temperature": model.temperature})


@torch.no_grad()
def embed(
    model: AudioMotion, pairs: AudioMotionWindows, sound: int | None = None
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d"]]:
    """Embeddings of all non-overlapping windows, or only those mostly of domain `sound`."""
    asked = pairs.grid(sound)
    heard = torch.cat([model.embed_audio(part) for part in torch.split(asked.sound, 64)])
    seen = torch.cat([model.embed_motion(part) for part in torch.split(asked.motion, 64)])
    return heard.numpy(), seen.numpy()


def retrieval_tables(model: AudioMotion, pairs: AudioMotionWindows) -> dict[str, dict[str, dict[str, object]]]:
    """A `retrieval_table` of all windows and one for each domain, where telling domains apart does not help."""
    tables = {"everything": retrieval_table(*embed(model, pairs))}
    for at, name in enumerate(DOMAINS):
        try:
            found = embed(model, pairs, at)
        except MotionError:  # no window of this domain
            continue
        if len(found[0]) >= FEWEST:
            tables[name] = retrieval_table(*found)
    return tables


def retrieval_table(
    sounds: Float[np.ndarray, "n d"], motions: Float[np.ndarray, "n d"]
) -> dict[str, dict[str, object]]:
    """The paper's table in both directions: all pairs, one gallery of 300, TMR's batches of 32; with chance levels."""
    table = {}
    for way, matrix in (
        ("audio to motion", similarity(sounds, motions)),
        ("motion to audio", similarity(motions, sounds)),
    ):
        found = {"all": retrieval(matrix), "gallery": gallery(matrix)}
        if len(matrix) >= 32:
            found["batches"] = batched(matrix)
        for protocol, scores in found.items():
            table[f"{way}, {protocol}"] = _row(scores) | {"chance": _row(chance(scores.gallery))}
    return table


def _row(scores: Retrieval) -> dict[str, object]:
    recall: dict[str, object] = {f"R@{k}": round(value, 3) for k, value in scores.recall.items()}
    return recall | {"MedR": scores.median_rank, "MRR": round(scores.reciprocal_rank, 3), "gallery": scores.gallery}
