"""Training of the small codec: draw, augment, encode, quantise, decode, compare.

Every batch is a pure function of (seed, step), so a run that is stopped and resumed from its last checkpoint
gives the same result. Float32 throughout: bfloat16 autocast makes these narrow convolutions slower on CPU.
May import the rest of the room, `quantize`, `training` and below.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor

from echoavatar import checkpoint
from echoavatar.models.audio.codec import AudioCodec
from echoavatar.models.audio.network import CODE_LAYERS, CodecConfig, Convolution, open_run
from echoavatar.models.quantize import ResidualVectorQuantizer, Share
from echoavatar.timing import SAMPLES_PER_AUDIO_TOKEN
from echoavatar_lab.training import Gather, Loss, Progress, TrainingConfig, TrainingTask, adamw, has_state, train

from ..tokenizer.usage import code_usage
from .augment import augment, source_samples
from .loss import SpectrumProbe, sound_loss
from .pool import AudioPool

_START_BATCHES = 20


class CodecTrainingConfig(TrainingConfig):
    """How the codec is trained; its sizes are in `codec`."""

    codec: CodecConfig = CodecConfig()
    steps: int = Field(default=3_000, gt=0, description="optimiser steps")
    batch: int = Field(default=6, gt=0, description="pieces of sound per step")
    decoded: int = Field(default=2, gt=0, description="of these, how many pass the decoder, the dearest part")
    crop_frames: int = Field(default=75, gt=0, description="length of a piece in frames of 320 samples")
    final_rate: float = Field(default=0.01, ge=0, le=1, description="share of the peak at the end of the cosine")
    weight_decay: float = Field(default=1e-4, ge=0, description="AdamW's decay")
    betas: tuple[float, float] = Field(default=(0.9, 0.98), description="AdamW's averages")
    unquantized: int = Field(300, ge=0, description="first steps without codebooks, so that they start sensible")
    commitment: float = Field(default=0.25, ge=0, description="weight of the distance to the codes")
    dropout: float = Field(default=0.15, ge=0, lt=1, description="chance of a batch with the first layer only")
    log_every: int = Field(default=25, gt=0, description="steps between lines of metrics.jsonl")
    save_every: int = Field(default=250, ge=0, description="steps between checkpoints; 0: by the clock only")


class Sounds(NamedTuple):
    """A batch: input and target sound, and each row's index in the batch."""

    heard: Float[Tensor, "b s"]
    target: Float[Tensor, "b s"]
    row: Int[Tensor, " b"]


class CodecTask(TrainingTask[Sounds]):
    """The networks that are trained, and their data."""

    config: CodecTrainingConfig

    def __init__(
        self, config: CodecTrainingConfig, pool: AudioPool, *, card: Mapping[str, object] | None = None
    ) -> None:
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
        super().__init__(config, {"codec": self.codec, "probe": self.probe, "quantizer": self.quantizer})
        self.pool, self._card = pool, dict(card or {})

    def begin_with(self, start: AudioCodec) -> None:
        """Take over a trained codec; only the probe begins anew.

        Raises:
            CheckpointError: it is of other sizes.
        """
        checkpoint.load_into(self.codec, start.state_dict(), origin="the codec to start from")
        books = {f"layers.{q}.codebook": book for q, book in enumerate(start.codebooks)}
        self.quantizer.load_state_dict(books)

    def identity(self) -> dict[str, CodecConfig]:
        """Sizes only: a resumed run may be given more minutes."""
        return {"codec": self.config.codec}

    def optimisers(self) -> list[torch.optim.Optimizer]:
        """AdamW."""
        return [adamw([self.codec, self.probe], self.config, decays_vectors=True)]

    def draw(self, step: int) -> Sounds:
        """See `TrainingTask.draw`."""
        return make_batch(self.config, self.pool, step)

    @torch.no_grad()
    def before(self, batch: Sounds, step: int) -> None:
        """K-means over the latents of many batches, because one batch has fewer vectors than a codebook."""
        if step < self.config.unquantized or self.quantizer.is_ready:
            return
        vectors = []
        for ahead in range(1, 1 + _START_BATCHES):
            heard = make_batch(self.config, self.pool, step + ahead).heard
            vectors.append(self._latents(heard.to(next(self.codec.parameters()).device)).flatten(0, 1))
        self.quantizer.initialise(torch.cat(vectors), torch.Generator().manual_seed(self.config.seed))

    def loss(self, batch: Sounds, step: int) -> Loss:
        """See `TrainingTask.loss`. Only the first rows of a batch are decoded."""
        config, rows = self.config, len(batch.row)
        latents = self._latents(batch.heard)
        terms: dict[str, Tensor] = {}
        told: dict[str, Tensor | float] = {}
        if self.quantizer.is_ready:
            share = Share(int(batch.row[0]), config.batch)
            quantized = self.quantizer(latents, dropout=config.dropout, generator=config.noise(step), share=share)
            latents, terms["commitment"] = quantized.latents, config.commitment * quantized.commitment
            usage = code_usage(quantized.codes, config.codec.codes).perplexity
            told = {f"perplexity_{q}": float(value) for q, value in enumerate(usage)}
            told["commitment"] = terms["commitment"]
        terms["probe"] = (self.probe(latents) - self.probe.target(batch.target)).abs().mean()
        decoded = int((batch.row < config.decoded).sum())
        if decoded:
            made = sound_loss(self.codec.synthesize(latents[:decoded]), batch.target[:decoded])
            weight = decoded / min(config.decoded, config.batch) * config.batch / rows  # 1 for a whole batch
            sounds = {"log_mel": made.log_mel, "mel": 20 * made.mel, "waveform": 3 * made.waveform}
            terms |= {name: weight * value for name, value in sounds.items()}
            told |= sounds
        return Loss(torch.stack(list(terms.values())).sum(), {"probe": terms["probe"], **told})

    def after(self, step: int, gather: Gather) -> None:
        """The codebooks learn from the whole batch."""
        self.quantizer.settle(gather, self.config.noise(step, 1))
        for q, book in enumerate(self.quantizer.books()):
            self.codec.codebooks[q] = book.codebook

    def save(self, folder: Path, step: int) -> None:
        """The codec."""
        facts = {
            "training": self.config.model_dump(mode="json", exclude={"codec"}),
            "steps_done": step,
            "training_minutes": round(self.seconds / 60, 1),
            "sound_seconds": self.pool.seconds,
        }
        weights = self.codec.state_dict()
        checkpoint.save(folder, config=self.codec.config, weights=weights, card=facts | self._card)

    def _latents(self, heard: Float[Tensor, "b s"]) -> Float[Tensor, "b n c"]:
        state = self.codec.init_state(len(heard))
        return self.codec.latents(heard, state, state.seen == 0)


@torch.no_grad()
def balance(codec: AudioCodec, *, seed: int) -> None:
    """Scale fresh weights so that every convolution answers noise at speaking level with unit variance.

    At -23 dBFS the nonlinearities are almost linear, and a linear encoder cannot tell loudness. EnCodec learns this
    in weeks of training; ours is trained for hours.
    """
    noise = torch.Generator().manual_seed(seed)
    x = 0.07 * torch.randn(2, 48 * SAMPLES_PER_AUDIO_TOKEN, 1, generator=noise)
    for network, loudness in ((codec.encoder, 1.0), (codec.decoder, 0.07)):
        run = open_run(network, len(x), padding=codec.config.padding)
        for layer in network.layers:
            x = run.layer(layer, x)
            if isinstance(layer, Convolution):
                assert layer.conv.bias is not None
                size = loudness if layer is network.layers[-1] else 1.0
                factor = size / x.std().clamp_min(1e-6)
                layer.conv.weight.mul_(factor)
                x = factor * (x - layer.conv.bias) + layer.conv.bias


def make_batch(config: CodecTrainingConfig, pool: AudioPool, step: int) -> Sounds:
    """Input and target sound of one step."""
    rng = np.random.default_rng([config.seed, step])
    samples = config.crop_frames * SAMPLES_PER_AUDIO_TOKEN
    pairs = []
    for _ in range(config.batch):
        factor, needed = source_samples(rng, samples)
        pairs.append(augment(rng, pool.draw(rng, needed), factor, samples))
    heard = torch.from_numpy(np.stack([pair.heard for pair in pairs]))
    target = torch.from_numpy(np.stack([pair.target for pair in pairs]))
    return Sounds(heard, target, torch.arange(config.batch))


def train_codec(
    config: CodecTrainingConfig,
    folder: Path,
    pool: AudioPool,
    *,
    card: Mapping[str, object] | None = None,
    start: AudioCodec | None = None,
    device: str = "cpu",
    trackers: Sequence[str] = (),
    progress: Progress | None = None,
) -> AudioCodec:
    """Train, or continue the run in `folder`, until the steps or minutes are used up.

    `folder` gets the codec's checkpoint, `training.safetensors` (to go on) and `metrics.jsonl`.

    A new run begins with the weights and codebooks of `start`, where given.

    Raises:
        CheckpointError: the folder holds a run of other sizes, or `start` is of other sizes.
    """
    stage = CodecTask(config, pool, card=card)
    if start is not None and not has_state(folder):
        stage.begin_with(start)
    train(stage, folder, device=device, trackers=trackers, progress=progress)
    return stage.codec.eval()
