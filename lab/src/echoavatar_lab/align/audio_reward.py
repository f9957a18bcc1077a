"""The audio-motion alignment reward: one embedding space for audio and motion (paper, Audio-Motion Alignment Reward).

Two encoders project audio and motion to d = 768 and normalise; the reward is the cosine of the two embeddings. They are
trained with InfoNCE in both directions. Labels are soft: windows of the same segment share the probability, because a
mirrored clip has the same audio. The temperature is learned and starts at 1 / 0.07.

Audio is encoded from codec tokens, by BEATs or by Wav2CLIP (`audio_encoders`). We depart from the paper in two ways.
Motion is encoded from the vectors of its codes, which are what the generator predicts (`motion` "features" is the
paper's: normalised motion features, decoded from the codes at 30 fps). And the paper averages over the
whole clip, so its embedding cannot say when anything happened. Here 4 s are pooled into 24 slices of 1/6 s with 32
channels each, and the cosine adds up what agrees at the same time. `slices` 1 is the paper's form: LayerNorm behind the
projection of the mean, and a plain transformer that knows positions by sinusoids alone.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.stored import read_config
from echoavatar.timing import (
    FRAMES_PER_MOTION_TOKEN,
    SAMPLE_RATE_HZ,
    SAMPLES_PER_AUDIO_TOKEN,
    SAMPLES_PER_MOTION_TOKEN,
    exact_div,
)
from echoavatar_lab import checkpoint
from echoavatar_lab.data.feature_statistics import FeatureStatistics
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.nn.blocks import FullBlock

from .audio_encoders import RATE_HZ, AudioEncoderConfig, Beats, TokenEncoder, Wav2Clip, WaveformEncoder, sinusoids
from .decoded_motion import DecodedMotion
from .rewards import ReferenceStatistics

FRAMES_PER_TOKEN = exact_div(SAMPLES_PER_MOTION_TOKEN, SAMPLES_PER_AUDIO_TOKEN)  # 10 audio frames a motion token
WINDOW_TOKENS = 30  # 4 s, what the reward is trained on
FIRST_TEMPERATURE = 1 / 0.07
LARGEST_TEMPERATURE = 100.0
MIN_SPREAD = 1e-6  # keeps the division finite where an untrained codec's code vectors are all alike


class AudioMotionConfig(Config):
    """Model sizes; the paper uses width 512, 4 layers, 8 heads and d 768."""

    audio_encoder: AudioEncoderConfig = Field(description="the audio encoder")
    motion: Literal["codes", "features"] = Field(
        default="codes", description="what motion is read as: vectors of codes, or motion features (paper)"
    )
    motion_channels: int = Field(
        gt=0, le=1 << 14, description="length of a motion token's vector, all body parts; or of a frame's features"
    )
    width: int = Field(default=128, gt=0, description="channels of both encoders (paper: 512)")
    layers: int = Field(default=4, gt=0, description="transformer layers of the motion encoder")
    heads: int = Field(default=4, gt=0, description="attention heads (paper: 8)")
    size: int = Field(default=768, gt=0, description="length of the embedding of 4 s")
    slices: int = Field(default=24, gt=0, le=4096, description="time slices of an embedding; 1: the whole clip (paper)")

    @property
    def is_whole(self) -> bool:
        """Whether the clip is one embedding, in the paper's form."""
        return self.slices == 1

    @model_validator(mode="after")
    def _slices_share_the_size(self) -> Self:
        if self.size % self.slices:
            raise ValueError(f"size ({self.size}) must be a multiple of slices ({self.slices})")
        return self


class AudioMotion(checkpoint.Checkpointed):
    """An audio encoder and a motion encoder that share one embedding space."""

    config_type = AudioMotionConfig
    motion_book: Tensor
    mean: Tensor
    std: Tensor
    varies: Tensor

    def __init__(
        self, config: AudioMotionConfig, *, sound_shape: tuple[int, ...], motion_shape: tuple[int, ...]
    ) -> None:
        """`sound_shape` is (layers, codes) of the codec, `motion_shape` (parts, layers, codes) of the tokenizer."""
        super().__init__()
        self.config = config
        width = config.width
        if config.motion == "codes":
            self.register_buffer("motion_book", torch.zeros(*motion_shape, config.motion_channels // motion_shape[0]))
        else:
            self.register_buffer("mean", torch.zeros(config.motion_channels))
            self.register_buffer("std", torch.ones(config.motion_channels))
            self.register_buffer("varies", torch.ones(config.motion_channels, dtype=torch.bool))
        self.audio_encoder: TokenEncoder | WaveformEncoder
        if config.audio_encoder.codec is None:
            self.audio_encoder = TokenEncoder(config.audio_encoder, sound_shape, width=width, heads=config.heads)
        else:  # its own projection is the paper's
            self.audio_encoder = WaveformEncoder(config.audio_encoder, width=config.size if config.is_whole else width)
        self.motion_in = nn.Linear(config.motion_channels, width)
        each = config.size // config.slices
        if config.is_whole:
            layer = nn.TransformerEncoderLayer(
                width, config.heads, 4 * width, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
            )
            self.motion: nn.Module = nn.TransformerEncoder(layer, config.layers, enable_nested_tensor=False)
            is_projected = config.audio_encoder.codec is not None
            self.sound_out: nn.Module = nn.Identity() if is_projected else nn.Linear(width, each)
            self.motion_out: nn.Module = nn.Linear(width, each)
        else:
            self.motion = nn.Sequential(*(FullBlock(width=width, heads=config.heads) for _ in range(config.layers)))
            self.sound_out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, each))
            self.motion_out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, each))
        self.sound_norm, self.motion_norm = (nn.LayerNorm(each) if config.is_whole else nn.Identity() for _ in range(2))
        self.log_temperature = nn.Parameter(torch.tensor(FIRST_TEMPERATURE).log())

    @classmethod
    def from_codebooks(
        cls,
        sound_book: Float[Tensor, "l A a"],
        motion_book: Float[Tensor, "p q K c"],
        *,
        statistics: FeatureStatistics | None = None,
        **sizes: int,
    ) -> Self:
        """An untrained model that reads codec tokens; both codebooks are scaled to unit spread.

        With `statistics` motion is read as features, which they normalise, and the codes of motion are not used.
        """
        audio_encoder = AudioEncoderConfig(channels=sound_book.shape[2])
        model = cls._build(audio_encoder, motion_book, tuple(sound_book.shape[:2]), sizes, statistics)
        assert isinstance(model.audio_encoder, TokenEncoder)
        model.audio_encoder.book.copy_(sound_book / sound_book.sum(0).std().clamp(min=MIN_SPREAD))
        return model

    @classmethod
    def from_network(
        cls,
        network: Beats | Wav2Clip,
        codec: AudioCodec,
        motion_book: Float[Tensor, "p q K c"],
        *,
        is_frozen: bool,
        statistics: FeatureStatistics | None = None,
        **sizes: int,
    ) -> Self:
        """An untrained model over BEATs or Wav2CLIP; its weights are copied, and kept fixed if `is_frozen`."""
        kinds = {"beats": network.config} if isinstance(network, Beats) else {"wav2clip": network.config}
        audio_encoder = AudioEncoderConfig.model_validate({"codec": codec.config, "is_frozen": is_frozen} | kinds)
        model = cls._build(audio_encoder, motion_book, (), sizes, statistics)
        assert isinstance(model.audio_encoder, WaveformEncoder)
        model.audio_encoder.network.load_state_dict(network.state_dict())
        model.audio_encoder.codec.load_state_dict(codec.state_dict())
        return model

    @classmethod
    def _build(
        cls,
        audio_encoder: AudioEncoderConfig,
        motion_book: Tensor,
        sound_shape: tuple[int, ...],
        sizes: Mapping[str, Any],
        statistics: FeatureStatistics | None,
    ) -> Self:
        channels = motion_book.shape[0] * motion_book.shape[3] if statistics is None else statistics.mean.numel()
        kind: Literal["codes", "features"] = "codes" if statistics is None else "features"
        config = AudioMotionConfig(audio_encoder=audio_encoder, motion=kind, motion_channels=channels, **sizes)
        model = cls(config, sound_shape=sound_shape, motion_shape=tuple(motion_book.shape[:3]))
        if statistics is None:
            model.motion_book.copy_(motion_book / motion_book.sum(1).std().clamp(min=MIN_SPREAD))
        else:
            for own, value in zip((model.mean, model.std, model.varies), statistics, strict=True):
                own.copy_(value)
        return model

    @property
    def temperature(self) -> Float[Tensor, ""]:
        """The factor (tau) that similarities are multiplied by."""
        return self.log_temperature.exp().clamp(max=LARGEST_TEMPERATURE)

    def embed_audio(self, sound: Tensor) -> Float[Tensor, "b d"]:
        """Unit embeddings of codec tokens (b, f, l) or of a 16 kHz waveform (b, s); d is `size` for 4 s."""
        if sound.is_floating_point():
            tokens = round(sound.shape[1] * SAMPLE_RATE_HZ / RATE_HZ / SAMPLES_PER_MOTION_TOKEN)
        else:
            tokens = sound.shape[1] // FRAMES_PER_TOKEN
        return self._pooled(self.sound_out(self.audio_encoder(sound)), tokens, self.sound_norm)

    def embed_motion(self, motion: Tensor) -> Float[Tensor, "b d"]:
        """Unit embeddings of motion codes (b, n, p, q) or, as the config says, features (b, t, c).

        d is `size` for 4 s.
        """
        tokens = motion.shape[1]
        if self.config.motion == "features":
            tokens //= FRAMES_PER_MOTION_TOKEN
            read = FeatureStatistics(self.mean, self.std, self.varies).normalize(motion)
        else:
            parts = [
                sum((self.motion_book[p, q][motion[:, :, p, q]] for q in range(motion.shape[3])), torch.zeros(()))
                for p in range(motion.shape[2])
            ]
            read = torch.cat(parts, -1)
        x = self.motion_in(read)
        states = self.motion(x + sinusoids(x.shape[1], x.shape[2]).to(x))
        return self._pooled(self.motion_out(states), tokens, self.motion_norm)

    def _pooled(self, states: Float[Tensor, "b t c"], tokens: int, norm: nn.Module) -> Float[Tensor, "b d"]:
        """Average over slices of equal duration, of which a shorter clip has fewer; in the paper's form over all."""
        slices = 1 if self.config.is_whole else max(1, round(self.config.slices * tokens / WINDOW_TOKENS))
        pooled = F.adaptive_avg_pool1d(states.transpose(1, 2), slices)
        return F.normalize(norm(pooled.flatten(1)), dim=-1)

    @torch.no_grad()
    def judge(self, motion: DecodedMotion, reference_statistics: ReferenceStatistics) -> float:
        """The reward function: cosine of the audio's and the motion's embedding (paper, Reward Computation)."""
        heard = self.embed_audio(torch.from_numpy(motion.audio_codes)[None])
        is_read = self.config.motion == "features"
        shown = motion.features[motion.lead :].astype(np.float32) if is_read else motion.motion_codes
        seen = self.embed_motion(torch.from_numpy(shown)[None])
        return float((heard * seen).sum())

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder. Raises CheckpointError if the folder holds no alignment reward."""
        config = read_config(folder, AudioMotionConfig)
        weights = checkpoint.read_weights(folder)
        sound, motion = (
            tuple(weights[name].shape[:-1]) if name in weights else (1,) * few
            for name, few in (("audio_encoder.book", 2), ("motion_book", 3))
        )
        build = partial(cls, config, sound_shape=sound, motion_shape=motion)
        return checkpoint.build_for(weights, build, origin=str(folder)).eval()


def info_nce(
    sounds: Float[Tensor, "b d"],
    motions: Float[Tensor, "b d"],
    temperature: Float[Tensor, ""],
    segments: Int[Tensor, " b"],
) -> Float[Tensor, ""]:
    """Bidirectional InfoNCE with soft labels (paper, equations L_a2m, L_m2a, L_CLIP).

    The pairs of one segment share the target probability evenly.
    """
    same = (segments[:, None] == segments[None, :]).float()
    similar, labels = temperature * sounds @ motions.T, same / same.sum(1, keepdim=True)
    return 0.5 * (F.cross_entropy(similar, labels) + F.cross_entropy(similar.T, labels))
