"""Training of the small codec: draw, augment, encode, quantise, decode, compare.

Every batch is a pure function of (seed, step), so a run that was stopped and resumed from its last checkpoint goes
on as if nothing had happened. Float32 throughout: bfloat16 autocast makes these narrow convolutions slower on CPU.
May import the rest of the room, `quantize` and below.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from .. import checkpoint
from ..config import Config
from ..quantize import ResidualVectorQuantizer, code_usage
from ..timing import SAMPLES_PER_AUDIO_TOKEN
from .augment import augment, source_samples
from .codec import AudioCodec
from .config import CODE_LAYERS, CodecConfig
from .loss import SpectrumProbe, sound_loss
from .pool import AudioPool
from .training_state import load_training, save_training

_START_BATCHES = 20

Progress = Callable[[int, int], None]


class CodecTrainingConfig(Config):
    """How the codec is trained; its sizes are in `codec`."""

    codec: CodecConfig = CodecConfig()
    steps: int = Field(default=3_000, gt=0, description="optimiser steps")
    minutes: float = Field(
        0.0, ge=0, description="stop after this many, the schedule fitted to them; 0: no limit"
    )
    batch: int = Field(default=6, gt=0, description="pieces of sound per step")
    decoded: int = Field(default=2, gt=0, description="of these, how many pass the decoder, the dearest part")
    crop_frames: int = Field(default=75, gt=0, description="length of a piece in frames of 320 samples")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak, after the warm-up")
    warmup: int = Field(default=100, ge=0, description="steps of linear warm-up")
    unquantized: int = Field(
        300, ge=0, description="first steps without codebooks, so that they start sensible"
    )
    commitment: float = Field(default=0.25, ge=0, description="weight of the distance to the codes")
    dropout: float = Field(
        default=0.15, ge=0, lt=1, description="chance of a batch with the first layer only"
    )
    seed: int = Field(default=0, description="of weights, sound and augmentation")
    save_every: int = Field(default=250, gt=0, description="steps between checkpoints")


class CodecTrainer(nn.Module):
    """Everything that learns, and one step of learning."""

    def __init__(self, config: CodecTrainingConfig) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.codec = AudioCodec(config.codec)
            self.probe = SpectrumProbe(width=config.codec.width)
        balance(self.codec, seed=config.seed)
        self.quantizer = ResidualVectorQuantizer(
            codes=config.codec.codes,
            width=config.codec.width,
            layers=CODE_LAYERS,
            decay=0.98,
            dead_below=0.3,
            kmeans_steps=10,
        )
        self.config = config
        self.optimizer = torch.optim.AdamW(
            [*self.codec.parameters(), *self.probe.parameters()],
            lr=config.learning_rate,
            betas=(0.9, 0.98),
            weight_decay=1e-4,
        )
        self.steps_done = 0
        self.seconds = 0.0

    def learn(self, pool: AudioPool) -> dict[str, float]:
        """One optimiser step; returns what the log keeps."""
        config, started = self.config, time.monotonic()
        heard, target = make_batch(config, pool, self.steps_done)
        state = self.codec.init_state(len(heard))
        latents = self.codec.latents(heard, state, state.seen == 0)
        losses: dict[str, Tensor] = {}
        metrics: dict[str, float] = {}
        if self.steps_done >= config.unquantized:
            if self.steps_done == config.unquantized:
                self._start_codebooks(pool)
            noise = torch.Generator().manual_seed(config.seed * 1_000_003 + self.steps_done)
            quantized = self.quantizer(latents, dropout=config.dropout, generator=noise)
            latents, losses["commitment"] = quantized.latents, config.commitment * quantized.commitment
            usage = code_usage(quantized.codes, config.codec.codes).perplexity
            metrics = {f"perplexity_{q}": float(value) for q, value in enumerate(usage)}
        losses["probe"] = (self.probe(latents) - self.probe.target(target)).abs().mean()
        made = sound_loss(self.codec.synthesize(latents[: config.decoded]), target[: config.decoded])
        losses |= {"log_mel": made.log_mel, "mel": 20 * made.mel, "waveform": 3 * made.waveform}
        self._descend(torch.stack(list(losses.values())).sum())
        self.steps_done += 1
        self.seconds += time.monotonic() - started
        return {name: float(value.detach()) for name, value in losses.items()} | metrics

    def fraction_done(self) -> float:
        """0..1, by steps or by the clock, whichever is further."""
        by_clock = self.seconds / 60 / self.config.minutes if self.config.minutes else 0.0
        return min(1.0, max(self.steps_done / self.config.steps, by_clock))

    def trained_codec(self) -> AudioCodec:
        """The codec with the codebooks as they are now."""
        for q, book in enumerate(self.quantizer.books()):
            self.codec.codebooks[q] = book.codebook
        return self.codec

    @torch.no_grad()
    def _start_codebooks(self, pool: AudioPool) -> None:
        """K-means over the latents of many batches: one batch has fewer vectors than a codebook."""
        vectors = []
        for ahead in range(1, 1 + _START_BATCHES):
            heard, _ = make_batch(self.config, pool, self.steps_done + ahead)
            state = self.codec.init_state(len(heard))
            vectors.append(self.codec.latents(heard, state, state.seen == 0).flatten(0, 1))
        residual = torch.cat(vectors)
        noise = torch.Generator().manual_seed(self.config.seed)
        for book in self.quantizer.books():
            book.initialise(residual, noise)
            residual = residual - book.lookup(book.nearest(residual))

    def _descend(self, loss: Tensor) -> None:
        warm = min(1.0, (self.steps_done + 1) / max(1, self.config.warmup))
        cooled = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * self.fraction_done()))
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.learning_rate * warm * cooled
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_([*self.codec.parameters(), *self.probe.parameters()], 1.0)
        self.optimizer.step()


@torch.no_grad()
def balance(codec: AudioCodec, *, seed: int) -> None:
    """Scale fresh weights so that every convolution answers noise at speaking level with unit variance.

    At -23 dBFS the nonlinearities are all but linear, and a linear encoder cannot hear loudness. (EnCodec, trained
    for weeks, finds this out by itself.)
    """
    noise = torch.Generator().manual_seed(seed)
    x = 0.07 * torch.randn(2, 1, 48 * SAMPLES_PER_AUDIO_TOKEN, generator=noise)
    for network, loudness in ((codec.encoder, 1.0), (codec.decoder, 0.07)):
        assert isinstance(network.layers, nn.Module)
        layers = list(network.layers.children())
        for layer in layers:
            conv = getattr(layer, "conv", None)
            if conv is not None:
                size = loudness if layer is layers[-1] else 1.0
                conv.weight.mul_(size / layer(x).std().clamp_min(1e-6))
            x = layer(x)


def make_batch(
    config: CodecTrainingConfig, pool: AudioPool, step: int
) -> tuple[Float[Tensor, "b s"], Float[Tensor, "b s"]]:
    """Heard and wanted sound of one step."""
    rng = np.random.default_rng([config.seed, step])
    samples = config.crop_frames * SAMPLES_PER_AUDIO_TOKEN
    pairs = []
    for _ in range(config.batch):
        factor, needed = source_samples(rng, samples)
        pairs.append(augment(rng, pool.draw(rng, needed), factor, samples))
    heard = torch.from_numpy(np.stack([pair.heard for pair in pairs]))
    return heard, torch.from_numpy(np.stack([pair.target for pair in pairs]))


def train_codec(
    config: CodecTrainingConfig,
    folder: Path,
    pool: AudioPool,
    *,
    card: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> AudioCodec:
    """Train, or go on with what `folder` holds, until the steps or minutes are used up.

    `folder` gets the codec's checkpoint, `training.safetensors` (to go on) and `metrics.jsonl`.

    Raises:
        CheckpointError: the folder holds a run of other sizes.
    """
    trainer = CodecTrainer(config)
    folder.mkdir(parents=True, exist_ok=True)
    load_training(folder, trainer)
    with (folder / "metrics.jsonl").open("a") as log:
        while trainer.fraction_done() < 1:
            metrics = trainer.learn(pool)
            if trainer.steps_done % 25 == 0:
                line = {"step": trainer.steps_done, "seconds": round(trainer.seconds, 1)}
                log.write(
                    json.dumps(line | {name: round(value, 4) for name, value in metrics.items()}) + "\n"
                )
                log.flush()
            if trainer.steps_done % config.save_every == 0:
                _save(folder, trainer, pool, card)
            if progress is not None:
                progress(trainer.steps_done, config.steps)
    _save(folder, trainer, pool, card)
    return trainer.trained_codec().eval()


def _save(folder: Path, trainer: CodecTrainer, pool: AudioPool, card: Mapping[str, object] | None) -> None:
    codec = trainer.trained_codec()
    facts = {
        "training": json.loads(trainer.config.model_dump_json(exclude={"codec"})),
        "steps_done": trainer.steps_done,
        "training_minutes": round(trainer.seconds / 60, 1),
        "sound_seconds": pool.seconds,
    }
    checkpoint.save(folder, config=codec.config, weights=codec.state_dict(), card=facts | dict(card or {}))
    save_training(folder, trainer)
