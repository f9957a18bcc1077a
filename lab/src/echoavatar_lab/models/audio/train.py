"""Training of the small codec: draw, augment, encode, quantise, decode, compare.

Every batch is a pure function of (seed, step), so a run that is stopped and resumed from its last checkpoint
gives the same result. Float32 throughout: bfloat16 autocast makes these narrow convolutions slower on CPU.

A small codec must generalise to voices, music and rooms that are not in its data. Changes of the source (pitch,
level) reach the target too; those of the channel (equaliser, room, band limit, noise) may be kept from it, so that the
codes learn to look through them. The loss compares mel spectra at several scales, the waveform, and a readout of the
codes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soxr
import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from echoavatar.models.audio.codec_config import CODE_LAYERS, CodecConfig
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN, exact_div
from echoavatar_lab import checkpoint
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.network import Convolution, Run, init_network_state
from echoavatar_lab.models.codebook_training import LearningQuantizer, Share
from echoavatar_lab.training import Gather, Loss, TrainingConfig, TrainingTask, adamw, seeded

from ..tokenizer.measure import code_usage
from .decoding import synthesize
from .mel import log_mel, mel_spectrum
from .recordings import AudioPool

FloatArray = Float[np.ndarray, " s"]
_FFT = 65_536


class Pair(NamedTuple):
    """Input of the encoder and target of the decoder."""

    heard: FloatArray
    target: FloatArray


def source_samples(rng: np.random.Generator, samples: int) -> tuple[float, int]:
    """A resampling factor (pitch and formants move by it), and how many source samples it needs."""
    factor = float(np.exp(rng.uniform(np.log(0.8), np.log(1.25)))) if rng.random() < 0.7 else 1.0
    return factor, int(np.ceil(samples * factor)) + 64


def augment(rng: np.random.Generator, source: FloatArray, factor: float, samples: int) -> Pair:
    """One training pair of `samples` from a longer piece of sound; `factor` and length from `source_samples`."""
    if factor != 1.0:
        source = soxr.resample(source, SAMPLE_RATE_HZ * factor, SAMPLE_RATE_HZ, quality="MQ")
    source = _level(rng, source[:samples].astype(np.float32))
    clean_target = rng.random() < 0.5
    heard = _channel(rng, source) if rng.random() < 0.8 else source
    target = source if clean_target else heard
    if rng.random() < 0.5:
        heard = heard + _noise(rng, samples, heard)
    return Pair(np.clip(heard, -1, 1).astype(np.float32), np.clip(target, -1, 1).astype(np.float32))


def _level(rng: np.random.Generator, source: FloatArray) -> FloatArray:
    """Bring sound (not silence) to -23 dBFS with a spread of 6 dB, about as the level control would."""
    rms = float(np.sqrt(np.mean(np.square(source)) + 1e-12))
    if rms < 1e-3:
        return source
    wanted = 10 ** (rng.normal(-23, 6) / 20)
    return np.asarray(source * min(wanted / rms, 0.98 / max(float(np.abs(source).max()), 1e-6)), np.float32)


def _channel(rng: np.random.Generator, source: FloatArray) -> FloatArray:
    """Equaliser, band limit and room, multiplied in the frequency domain."""
    size = _FFT if len(source) <= _FFT // 2 else 1 << (2 * len(source) - 1).bit_length()
    frequency = np.fft.rfftfreq(size, 1 / SAMPLE_RATE_HZ)
    response = _equaliser(rng, frequency).astype(np.complex64)
    if rng.random() < 0.3:
        response *= 1 / np.sqrt(1 + (frequency / rng.uniform(3_000, 9_000)) ** 16)
    if rng.random() < 0.3:
        low = rng.uniform(60, 300)
        response *= (frequency / low) ** 2 / np.sqrt(1 + (frequency / low) ** 4)
    if rng.random() < 0.35:
        response *= np.fft.rfft(_room(rng), size)
    wet = np.fft.irfft(np.fft.rfft(source, size) * response, size)[: len(source)]
    power, before = np.mean(np.square(wet)), np.mean(np.square(source))
    return np.asarray(wet * np.sqrt((before + 1e-12) / (power + 1e-12)), np.float32)


def _equaliser(rng: np.random.Generator, frequency: FloatArray) -> FloatArray:
    """A tilt and three bells of up to 9 dB: rooms, microphones, other speakers."""
    octave = np.log2(np.maximum(frequency, 20) / 1_000)
    gain_db = rng.normal(0, 1.5) * octave
    for _ in range(3):
        centre, width = rng.uniform(-3, 3.3), rng.uniform(0.3, 1.2)
        gain_db = gain_db + rng.uniform(-9, 9) * np.exp(-(((octave - centre) / width) ** 2))
    return np.asarray(10 ** (np.clip(gain_db, -30, 15) / 20))


def _room(rng: np.random.Generator) -> FloatArray:
    """Direct sound and an exponential tail of noise (60 dB down after 0.15 to 0.6 s)."""
    length = SAMPLE_RATE_HZ // 2
    decay = np.exp(-6.9 * np.arange(length) / (SAMPLE_RATE_HZ * rng.uniform(0.15, 0.6)))
    tail = rng.standard_normal(length) * decay
    tail *= rng.uniform(0.1, 0.6) / np.sqrt(np.sum(np.square(tail)))
    tail[0] += 1
    return np.asarray(tail, np.float32)


def _noise(rng: np.random.Generator, samples: int, heard: FloatArray) -> FloatArray:
    """Coloured noise, 8 to 35 dB below the sound (or at -70 dBFS where there is none)."""
    spectrum = np.fft.rfft(rng.standard_normal(samples).astype(np.float32))
    spectrum *= (np.arange(len(spectrum)) + 20.0) ** (-rng.uniform(0, 1))
    noise = np.fft.irfft(spectrum, samples)
    level = max(float(np.sqrt(np.mean(np.square(heard)))), 10 ** (-45 / 20)) * 10 ** (-rng.uniform(8, 35) / 20)
    return np.asarray(noise * level / (np.sqrt(np.mean(np.square(noise))) + 1e-12), np.float32)


_SCALES = ((2048, 512, 80), (1024, 256, 80), (512, 128, 48), (256, 64, 24))  # FFT, hop, bands
_PROBE_STEPS = 4  # mel frames per latent frame: 300 Hz, fine enough for onsets
_PROBE_BANDS, _PROBE_WIDTH = 64, 192


class SpectrumProbe(nn.Module):
    """Reads log-mel spectra off the quantised latents; used in training only.

    It makes the codes carry what motion depends on (onsets, loudness, timbre, pitch region) and is much cheaper than
    the decoder. EnCodec has an adversary in its place.
    """

    def __init__(self, *, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv1d(width, _PROBE_WIDTH, 5, padding=2),
            nn.ELU(),
            nn.Conv1d(_PROBE_WIDTH, _PROBE_STEPS * _PROBE_BANDS, 3, padding=1),
        )
        nn.init.constant_(self.layers[-1].bias, -8.0)  # type: ignore[arg-type]  # the logarithm of soft sound

    def forward(self, latents: Float[Tensor, "b n c"]) -> Float[Tensor, "b t m"]:
        """Predicted log-mel, t = 4 n."""
        out = self.layers(latents.transpose(1, 2)).transpose(1, 2)
        return out.reshape(len(latents), -1, _PROBE_BANDS)  # type: ignore[no-any-return]

    def target(self, audio: Float[Tensor, "b s"]) -> Float[Tensor, "b t m"]:
        """The target of `forward`, t = 4 s / 320."""
        hop = exact_div(SAMPLES_PER_AUDIO_TOKEN, _PROBE_STEPS)
        return log_mel(audio, fft=512, hop=hop, bands=_PROBE_BANDS)[:, :-1]


class SoundLoss(NamedTuple):
    """Each term averaged over its elements."""

    log_mel: Float[Tensor, ""]
    mel: Float[Tensor, ""]
    waveform: Float[Tensor, ""]


def sound_loss(made: Float[Tensor, "b s"], wanted: Float[Tensor, "b s"]) -> SoundLoss:
    """Distance of two sounds, absolute differences throughout; mel terms are means over four window sizes."""
    logs, linears = [], []
    for fft, hop, bands in _SCALES:
        ours = mel_spectrum(made, fft=fft, hop=hop, bands=bands)
        theirs = mel_spectrum(wanted, fft=fft, hop=hop, bands=bands)
        logs.append((torch.log(ours + 1e-5) - torch.log(theirs + 1e-5)).abs().mean())
        linears.append((ours - theirs).abs().mean())
    return SoundLoss(torch.stack(logs).mean(), torch.stack(linears).mean(), (made - wanted).abs().mean())


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
        with seeded(config.seed):
            self.codec = AudioCodec(config.codec)
            self.probe = SpectrumProbe(width=config.codec.width)
        balance(self.codec, seed=config.seed)
        self.quantizer = LearningQuantizer(
            codes=config.codec.codes,
            width=config.codec.width,
            layers=CODE_LAYERS,
            decay=0.98,
            dead_below=0.3,
            kmeans_steps=10,
        )
        super().__init__(config, {"codec": self.codec, "probe": self.probe, "quantizer": self.quantizer}, card)
        self.pool = pool

    def begin_with(self, start: AudioCodec) -> None:
        """Take over a trained codec; only the probe begins anew. Raises CheckpointError if it is of other sizes."""
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
            made = sound_loss(synthesize(self.codec, latents[:decoded]), batch.target[:decoded])
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
        facts: dict[str, object] = {
            "training": self.config.model_dump(mode="json", exclude={"codec"}),
            "steps_done": step,
            "training_minutes": round(self.seconds / 60, 1),
            "sound_seconds": self.pool.seconds,
        }
        self.codec.save(folder, facts | self._card)

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
        state = init_network_state(network, len(x))
        run = Run(iter(state.convolutions), state, state.seen == 0, state.seen == 0, codec.config.padding)
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
