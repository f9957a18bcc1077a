"""Training of the face model: flow matching with audio dropout.

Paper, Face Animation Generator: MSE flow matching, 10 % audio dropout, AdamW 2e-4, batch 128, windows of 64 frames,
300 000 iterations, "temporal speed perturbation with factors {0.9, 1.0, 1.1} using cubic interpolation for motion and
time-stretch for audio". The stretch keeps the pitch: overlapping windows, each laid where it fits best. Everything
random in a step follows from the seed and the step's number.

Departs from the paper: the history that the model sees is corrupted, so that the model uses the sound instead of
copying the last frame. The encoder, which is not pretrained as HuBERT is, may train alone at first. The gap between the
lips has a weight of its own, and the face is also predicted from the encoder alone (`FaceReader`). Through the flow
head the encoder learns little, because the previous frame predicts most of a face; but it does not predict that the
lips will close.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field
from scipy.interpolate import CubicSpline
from torch import Tensor, nn

from echoavatar.errors import MotionError
from echoavatar.models.audio import LevelControl
from echoavatar.models.face.config import FaceConfig, HubertConfig, MelConfig
from echoavatar.models.face.noise import FULL_NOISE
from echoavatar.motion.arkit import ARKIT_NAMES
from echoavatar.timing import CHUNK_FRAMES, SAMPLES_PER_FRAME
from echoavatar_lab import checkpoint
from echoavatar_lab.models.face.encoder import HubertEncoder
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.paper import FACE
from echoavatar_lab.training import Loss, TrainingConfig, TrainingTask, seeded

from .clip import FaceClip


def paper_face(*, width: int = 256, encoder: MelConfig | HubertConfig | None = None) -> FaceConfig:
    """The sizes of the paper (256), or with `width` 64 of the release, reading its history anew for every chunk."""
    sizes = {**FACE["model"], "encoder": encoder or HubertConfig(), "width": width, "head_width": width}
    return FaceConfig.model_validate(sizes)


class FaceTraining(TrainingConfig):
    """How a face model is trained. The defaults suit a small model on a CPU; the descriptions give the paper's."""

    steps: int = Field(default=8000, gt=0, description="optimiser steps of the whole schedule (paper: 300,000)")
    batch: int = Field(default=32, gt=0, description="windows per step (paper: 128)")
    betas: tuple[float, float] = Field(default=(0.9, 0.98), description="AdamW's averages")
    frames: int = Field(default=64, gt=0, multiple_of=CHUNK_FRAMES, description="frames per window (paper: 64)")
    learning_rate: float = Field(default=1e-3, gt=0, description="peak of the schedule (paper: 2e-4, constant)")
    audio_dropout: float = Field(default=0.1, ge=0, le=1, description="share of windows without sound (paper: 0.1)")
    history_noise: float = Field(
        default=1.5, ge=0, description="largest deviation of the noise on a window's history; 0 as in the paper"
    )
    history_dropout: float = Field(
        default=0.3, ge=0, le=1, description="share of windows whose history is the mean face; 0 as in the paper"
    )
    gain_db: float = Field(default=6.0, ge=0, description="windows are made louder or softer by up to this")
    high_noise: float = Field(
        default=2.0,
        ge=1,
        description="noise levels are u^(1 / this), u uniform: high noise makes sound tell; 1 is uniform",
    )
    lips: float = Field(
        default=0.3,
        ge=0,
        description="weight of the error of the lips' opening, four times where they touch; 0 as in the paper",
    )
    listen: int = Field(
        default=0, ge=0, description="first steps, in which the encoder alone learns, by a readout of the face; cheap"
    )
    listening_rate: float = Field(default=2e-3, gt=0, description="peak of the schedule of these first steps")
    readout: float = Field(
        default=0.3, ge=0, description="weight of that readout's error in the steps that follow; 0 as in the paper"
    )
    tempo: bool = Field(default=True, description="clips also a tenth slower and faster (paper); triples them")
    draws: int = Field(default=2, gt=0, description="noise levels per frame and step")


SPEEDS = (0.9, 1.0, 1.1)
_HOP = 360  # 15 ms
_SEARCH = 160  # samples to either side


def at_speed(clip: FaceClip, speed: float) -> FaceClip:
    """The clip at this multiple of its speed; 1.1 is shorter."""
    if speed == 1.0:
        return clip
    frames = max(2, round(len(clip.curves) / speed))
    audio = stretch(clip.audio, frames * SAMPLES_PER_FRAME)
    return FaceClip(f"{clip.name}-{speed:g}", audio, resample_curves(clip.curves, frames), clip.split)


def resample_curves(curves: Float[np.ndarray, "t c"], frames: int) -> Float[np.ndarray, "n c"]:
    """Curves resampled to `frames` frames by cubic splines through the frames' middles; clipped to 0..1."""
    if len(curves) < 2:
        return np.repeat(curves, frames, axis=0)
    middles = (np.arange(frames) + 0.5) * len(curves) / frames - 0.5
    spline = CubicSpline(np.arange(len(curves)), curves, axis=0)
    return np.asarray(np.clip(spline(np.clip(middles, 0, len(curves) - 1)), 0, 1), np.float32)


def stretch(audio: Float[np.ndarray, " s"], samples: int) -> Float[np.ndarray, " n"]:
    """The sound stretched to this many samples at its own pitch (WSOLA: overlap-add, aligned by correlation)."""
    window = np.hanning(2 * _HOP + 1)[:-1]
    edge = 2 * _HOP + 2 * _SEARCH
    source = np.pad(audio, edge).astype(np.float64)
    out = np.zeros(samples + 2 * edge)
    ratio = len(audio) / max(samples, 1)
    taken = edge - _HOP
    for start in range(0, samples + _HOP, _HOP):
        ideal = edge - _HOP + round(start * ratio)
        if start:
            taken = ideal + _best_shift(source, wanted=taken + _HOP, ideal=ideal)
        taken = min(max(taken, 0), len(source) - 2 * _HOP)
        out[start : start + 2 * _HOP] += window * source[taken : taken + 2 * _HOP]
    return out[_HOP : _HOP + samples].astype(np.float32)


def _best_shift(source: Float[np.ndarray, " s"], *, wanted: int, ideal: int) -> int:
    """The shift near `ideal` at which the sound is most like the natural continuation."""
    pattern = source[wanted : wanted + 2 * _HOP]
    first = max(ideal - _SEARCH, 0)
    region = source[first : ideal + _SEARCH + 2 * _HOP]
    if len(pattern) < 2 * _HOP or len(region) <= 2 * _HOP or not pattern.any():
        return 0
    likeness = np.correlate(region, pattern, mode="valid")
    energy = np.convolve(region**2, np.ones(2 * _HOP), mode="valid")
    shifts = first + np.arange(len(likeness)) - ideal
    nearer = 1 - 0.02 * np.abs(shifts) / _SEARCH  # a periodic sound fits at every period: prefer near shifts
    return int(shifts[np.argmax(nearer * likeness / np.sqrt(energy + 1e-6))])


class FaceBatch(NamedTuple):
    """Windows: sound, curves, and the frame before each window."""

    audio: Float[Tensor, "b s"]
    curves: Float[Tensor, "b t c"]
    before: Float[Tensor, "b c"]


class FaceSampler:
    """Windows of clips at the given speeds, starting at any frame; the same for the same seed and step."""

    def __init__(
        self,
        clips: Sequence[FaceClip],
        *,
        frames: int,
        seed: int,
        gain_db: float = 0.0,
        speeds: Sequence[float] = SPEEDS,
        late: int = 0,
    ) -> None:
        """`late`: frames by which the face of a window follows its sound."""
        long_enough = [clip for clip in clips if round(len(clip.curves) / max(speeds)) > frames]
        if not long_enough:
            raise MotionError(f"no face clip of split train is longer than {frames} frames; record longer takes")
        self._versions = [[following(at_speed(clip, speed), late) for speed in speeds] for clip in long_enough]
        lengths = np.array([len(clip.curves) for clip in long_enough], float)
        self._share, self._frames, self._seed, self._gain_db = lengths / lengths.sum(), frames, seed, gain_db

    def batch(self, step: int, rows: int) -> FaceBatch:
        """The windows of one step."""
        rng = np.random.default_rng([self._seed, step])
        audio, curves, before = [], [], []
        for which in rng.choice(len(self._versions), rows, p=self._share):
            clip = self._versions[which][rng.integers(len(self._versions[which]))]
            first = int(rng.integers(len(clip.curves) - self._frames + 1))
            last = first + self._frames
            gain = 10 ** (rng.uniform(-self._gain_db, self._gain_db) / 20)
            audio.append(gain * clip.audio[first * SAMPLES_PER_FRAME : last * SAMPLES_PER_FRAME])
            curves.append(clip.curves[first:last])
            before.append(clip.curves[max(first - 1, 0)])
        return FaceBatch(*(torch.from_numpy(np.stack(part).astype(np.float32)) for part in (audio, curves, before)))


def following(clip: FaceClip, frames: int) -> FaceClip:
    """The clip with its face delayed by some frames; the first face is held meanwhile."""
    held = np.repeat(clip.curves[:1], frames, axis=0)
    return replace(clip, curves=np.concatenate([held, clip.curves[: len(clip.curves) - frames]]))


def levelled(clip: FaceClip) -> FaceClip:
    """The clip as the live model hears it, behind the level control."""
    return replace(clip, audio=LevelControl()(clip.audio[None])[0])


TOUCHING = 0.05  # gap of closed lips, as a share of the jaw's range


def normalized(model: FaceModel, curves: Float[Tensor, "*b c"]) -> Float[Tensor, "*b c"]:
    """Curves at zero mean and unit variance; still channels become 0."""
    return (curves - model.mean) / model.scale() * model.moving()


class FaceReader(nn.Module):
    """A linear readout of the encoder's features: the face (normalised), and whether the lips touch (logit)."""

    def __init__(self, features: int, channels: int) -> None:
        super().__init__()
        self.read = nn.Linear(features, channels + 1)

    def loss(
        self, model: FaceModel, features: Float[Tensor, "b t a"], curves: Float[Tensor, "b t c"]
    ) -> Float[Tensor, ""]:
        """Squared error over the channels that move, and cross-entropy of touching."""
        read, moving = self.read(features), model.moving()
        error = (read[..., :-1] - normalized(model, curves)).square() * moving
        touching = (_apart(curves) <= TOUCHING).to(read)
        far: Tensor = error.sum() / (read[..., 0].numel() * moving.sum().clamp_min(1))
        return far + F.binary_cross_entropy_with_logits(read[..., -1], touching)


def add_noise(
    clean: Float[Tensor, "*b c"], noise: Float[Tensor, "*b c"], times: Int[Tensor, "*b"]
) -> Float[Tensor, "*b c"]:
    """The straight path of flow matching: clean at time 0, noise at 1000."""
    level = (times / FULL_NOISE)[..., None].to(clean)
    return torch.lerp(clean, noise, level)


class FlowNoise(NamedTuple):
    """All random numbers in the loss of a batch."""

    strength: Float[Tensor, "b 1 1"]  # of the noise on a window's history, in its largest
    history: Float[Tensor, "b t c"]
    keeps_history: Float[Tensor, "b 1 1"]  # 0 where the history is dropped
    keeps_sound: Float[Tensor, "b 1 1"]
    level: Float[Tensor, "b n t"]  # of the noise on the frames to predict, uniform
    noise: Float[Tensor, "b n t c"]


def draw_noise(curves: Float[Tensor, "b t c"], training: FaceTraining, random: torch.Generator) -> FlowNoise:
    """Noise for windows of these sizes."""
    rows, frames, channels = curves.shape
    strength = torch.rand(rows, 1, 1, generator=random)
    history = torch.randn(rows, frames, channels, generator=random)
    keeps_history, keeps_sound = (
        (torch.rand(rows, 1, 1, generator=random) >= share).float()
        for share in (training.history_dropout, training.audio_dropout)
    )
    shape = (training.draws, rows, frames)
    level = torch.rand(shape, generator=random)
    noise = torch.randn(*shape, channels, generator=random)
    return FlowNoise(strength, history, keeps_history, keeps_sound, level.transpose(0, 1), noise.transpose(0, 1))


def flow_loss(
    model: FaceModel, batch: FaceBatch, training: FaceTraining, random: FlowNoise, *, features: Float[Tensor, "b t a"]
) -> Float[Tensor, ""]:
    """Squared error of the clean face seen behind noise (normalised), over the channels that move, and of the lips.

    `features` are the encoder's, of the batch's sound.
    """
    clean = normalized(model, batch.curves)
    history = torch.cat([normalized(model, batch.before)[:, None], clean[:, :-1]], 1)
    noisy = history + training.history_noise * random.strength * random.history
    history = noisy * random.keeps_history * model.moving()
    sound = model.gpt.sound_proj(features) * random.keeps_sound
    condition = model.gpt(history, sound)
    shape = (training.draws, *clean.shape[:2])
    level = random.level.transpose(0, 1).contiguous() ** (1 / training.high_noise)
    times = (level * FULL_NOISE).ceil().long().clamp(1, FULL_NOISE)
    noise = random.noise.transpose(0, 1).contiguous()
    seen = model.head(add_noise(clean.expand(*shape, -1), noise, times), times, condition.expand(*shape, -1))
    error = (seen - clean).square() * model.moving()
    loss: Tensor = error.sum() / (math.prod(shape) * model.moving().sum().clamp_min(1))
    return loss + training.lips * lip_error(model.denormalize(seen), batch.curves) if training.lips else loss


def lip_error(seen: Float[Tensor, "n b t c"], curves: Float[Tensor, "b t c"]) -> Float[Tensor, ""]:
    """Squared error of the gap between the lips, in tenths of the jaw's range; closed lips weigh most."""
    wanted = _apart(curves)
    weight = torch.where(wanted <= TOUCHING, 4.0, 1.0)
    return (weight * (_apart(seen) - wanted).square()).mean() * 100


def _apart(curves: Float[Tensor, "*b c"]) -> Float[Tensor, "*b"]:
    return curves[..., ARKIT_NAMES.index("jawOpen")] - curves[..., ARKIT_NAMES.index("mouthClose")]


class FaceLesson(NamedTuple):
    """A batch: windows and all noise of the loss."""

    windows: FaceBatch
    noise: FlowNoise


class FaceTask(TrainingTask[FaceLesson]):
    """A face model and the clips of split "train"."""

    kind = "face"
    config: FaceTraining

    def __init__(
        self,
        config: FaceConfig,
        training: FaceTraining,
        clips: Sequence[FaceClip],
        *,
        encoder: HubertEncoder | None = None,
        card: Mapping[str, object] | None = None,
    ) -> None:
        """A pretrained `encoder`, of the config's sizes, is kept as it is; the rest learns."""
        with seeded(training.seed):
            self.model = FaceModel(config)
            self.reader = FaceReader(config.encoder.outputs, config.channels)
        if encoder is not None:
            checkpoint.load_into(self.model.encoder, encoder.state_dict(), origin="the pretrained encoder")
            self.model.encoder.requires_grad_(False).eval()  # training neither changes nor masks nor drops anything
        super().__init__(training, {"model": self.model, "reader": self.reader}, card)
        self.has_idle = training.listen > 0
        chosen = [levelled(clip) for clip in clips if clip.split == "train"]
        self.sampler = FaceSampler(
            chosen,
            frames=training.frames,
            seed=training.seed,
            gain_db=training.gain_db,
            speeds=SPEEDS if training.tempo else (1.0,),
            late=config.late,
        )
        curves = torch.from_numpy(np.concatenate([clip.curves for clip in chosen]))
        self.model.mean.copy_(curves.mean(0))
        self.model.std.copy_(curves.std(0))

    def rate(self, step: int, done: float) -> float:
        """Warm-up and decay; the steps in which the encoder trains alone have a schedule of their own."""
        training, listen = self.config, self.config.listen
        if step < listen:
            alone = {"learning_rate": training.listening_rate, "steps": listen}
            return training.model_copy(update=alone).rate_at(step)
        return training.model_copy(update={"steps": max(1, training.steps - listen)}).rate_at(step - listen)

    def draw(self, step: int) -> FaceLesson:
        """See `TrainingTask.draw`."""
        windows = self.sampler.batch(step, self.config.batch)
        return FaceLesson(windows, draw_noise(windows.curves, self.config, self.config.noise(step)))

    def loss(self, batch: FaceLesson, step: int) -> Loss:
        """See `TrainingTask.loss`."""
        training, windows = self.config, batch.windows
        features = self.model.encoder(windows.audio)
        read = self.reader.loss(self.model, features, windows.curves)
        if step < training.listen:
            return Loss(read, {"read": read})
        flow = flow_loss(self.model, windows, training, batch.noise, features=features)
        return Loss(flow + training.readout * read, {"read": read})
