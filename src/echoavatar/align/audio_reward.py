"""The audio-motion alignment reward: one embedding of sound and motion (paper, appendix Audio-Motion Alignment Reward).

Both sides are projected to d = 768 and normed; the reward is their cosine. Trained with InfoNCE in both directions,
with soft labels: windows of the same segment (mirrored motion has the same sound) share the probability. The
temperature is learnt from 1 / 0.07.

Departs from the paper in two things. Sound and motion are read as their codes' vectors (what the generator hears and
says), sound by a small encoder that is trained along; BEATs needs the waveform, which token files do not hold. And the
paper's mean over all of a clip's time cannot say when anything happened: here 4 s are pooled into 24 slices of 1/6 s
that stay apart in the embedding (32 channels each), so that the cosine is a sum of what agrees at the same time.
`slices` 1 is the paper's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Self

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from .. import checkpoint
from ..config import Config
from ..timing import SAMPLES_PER_AUDIO_TOKEN, SAMPLES_PER_MOTION_TOKEN, exact_div
from .bidirectional import FullBlock, sinusoids
from .scene import Scene
from .yardstick import Yardstick

FRAMES_PER_TOKEN = exact_div(
    SAMPLES_PER_MOTION_TOKEN, SAMPLES_PER_AUDIO_TOKEN
)  # 10 audio frames a motion token
WINDOW_TOKENS = 30  # 4 s, what the reward is trained on
HALF = exact_div(FRAMES_PER_TOKEN, 2)  # sound is read at 15 Hz
FIRST_TEMPERATURE = 1 / 0.07
LARGEST_TEMPERATURE = 100.0


class AudioMotionConfig(Config):
    """Sizes; the paper's are width 512, 4 layers, 8 heads, d 768."""

    sound_channels: int = Field(gt=0, description="length of an audio code's vector, both layers summed")
    motion_channels: int = Field(gt=0, description="length of a motion token's vector, parts side by side")
    width: int = Field(default=128, gt=0, description="channels of both encoders (paper: 512)")
    layers: int = Field(default=4, gt=0, description="transformer layers of the motion encoder")
    sound_layers: int = Field(default=2, gt=0, description="transformer layers of the small sound encoder")
    heads: int = Field(default=4, gt=0, description="attention heads (paper: 8)")
    size: int = Field(default=768, gt=0, description="length of an embedding of 4 s")
    slices: int = Field(default=24, gt=0, description="times that an embedding of 4 s keeps apart (paper: 1)")

    @model_validator(mode="after")
    def _slices_share_the_size(self) -> Self:
        if self.size % self.slices:
            raise ValueError(f"size ({self.size}) must be a multiple of slices ({self.slices})")
        return self


class SoundEncoder(nn.Module):
    """The small encoder: vectors at 75 Hz, brought to 15 Hz by a convolution, then attention."""

    def __init__(self, config: AudioMotionConfig) -> None:
        super().__init__()
        self.before = nn.Conv1d(config.sound_channels, config.width, 3, padding=1)
        self.down = nn.Conv1d(config.width, config.width, HALF, stride=HALF)
        self.blocks = nn.Sequential(
            *(FullBlock(width=config.width, heads=config.heads) for _ in range(config.sound_layers))
        )

    def forward(self, x: Float[Tensor, "b f c"]) -> Float[Tensor, "b t d"]:
        """States at 15 Hz."""
        y = F.gelu(self.before(x.transpose(1, 2)))
        y = self.down(y).transpose(1, 2)
        states: Tensor = self.blocks(y + sinusoids(y.shape[1], y.shape[2]).to(y))
        return states


class AudioMotion(nn.Module):
    """Two encoders into one space."""

    sound_book: Tensor
    motion_book: Tensor

    def __init__(
        self, config: AudioMotionConfig, *, sound_shape: tuple[int, ...], motion_shape: tuple[int, ...]
    ) -> None:
        """`sound_shape` is (layers, codes) of the codec, `motion_shape` (parts, layers, codes) of the tokenizer."""
        super().__init__()
        self.config = config
        width = config.width
        self.register_buffer("sound_book", torch.zeros(*sound_shape, config.sound_channels))
        self.register_buffer(
            "motion_book", torch.zeros(*motion_shape, config.motion_channels // motion_shape[0])
        )
        self.sound = SoundEncoder(config)
        self.motion_in = nn.Linear(config.motion_channels, width)
        self.motion = nn.Sequential(
            *(FullBlock(width=width, heads=config.heads) for _ in range(config.layers))
        )
        each = config.size // config.slices
        self.sound_out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, each))
        self.motion_out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, each))
        self.log_temperature = nn.Parameter(torch.tensor(FIRST_TEMPERATURE).log())

    @classmethod
    def over(
        cls, sound_book: Float[Tensor, "l A a"], motion_book: Float[Tensor, "p q K c"], **sizes: int
    ) -> Self:
        """Over the code vectors of a codec and a tokenizer, scaled to unit spread."""
        parts, channels = motion_book.shape[0], motion_book.shape[3]
        config = AudioMotionConfig(
            sound_channels=sound_book.shape[2], motion_channels=parts * channels, **sizes
        )
        model = cls(
            config, sound_shape=tuple(sound_book.shape[:2]), motion_shape=tuple(motion_book.shape[:3])
        )
        model.sound_book.copy_(sound_book / sound_book.sum(0).std())
        model.motion_book.copy_(motion_book / motion_book.sum(1).std())
        return model

    @property
    def temperature(self) -> Float[Tensor, ""]:
        """tau, what similarities are multiplied by."""
        return self.log_temperature.exp().clamp(max=LARGEST_TEMPERATURE)

    def hear(self, codes: Int[Tensor, "b f l"]) -> Float[Tensor, "b d"]:
        """Unit embeddings of sound; d is `size` for 4 s."""
        vectors = sum(
            (self.sound_book[layer][codes[..., layer]] for layer in range(codes.shape[2])), torch.zeros(())
        )
        return self._pooled(self.sound_out(self.sound(vectors)), codes.shape[1] // FRAMES_PER_TOKEN)

    def see(self, codes: Int[Tensor, "b n p q"]) -> Float[Tensor, "b d"]:
        """Unit embeddings of motion; d is `size` for 4 s."""
        parts = [
            sum((self.motion_book[p, q][codes[:, :, p, q]] for q in range(codes.shape[3])), torch.zeros(()))
            for p in range(codes.shape[2])
        ]
        x = self.motion_in(torch.cat(parts, -1))
        states = self.motion(x + sinusoids(x.shape[1], x.shape[2]).to(x))
        return self._pooled(self.motion_out(states), codes.shape[1])

    def _pooled(self, states: Float[Tensor, "b t c"], tokens: int) -> Float[Tensor, "b d"]:
        """Slices of the same length whatever the clip's; a clip that is shorter has fewer."""
        slices = max(1, round(self.config.slices * tokens / WINDOW_TOKENS))
        pooled = F.adaptive_avg_pool1d(states.transpose(1, 2), slices)
        return F.normalize(pooled.flatten(1), dim=-1)

    @torch.no_grad()
    def judge(self, scene: Scene, yardstick: Yardstick) -> float:
        """As a reward function: the cosine of what is heard and what is done (paper, Reward Computation)."""
        heard = self.hear(torch.from_numpy(scene.audio_codes)[None])
        seen = self.see(torch.from_numpy(scene.motion_codes)[None])
        return float((heard * seen).sum())

    def save(self, folder: Path, card: Mapping[str, object]) -> None:
        """Write a checkpoint folder."""
        shapes = {
            "sound_shape": list(self.sound_book.shape[:2]),
            "motion_shape": list(self.motion_book.shape[:3]),
        }
        checkpoint.save(folder, config=self.config, weights=self.state_dict(), card=dict(card) | shapes)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a checkpoint folder.

        Raises:
            CheckpointError: it holds no alignment reward.
        """
        config = checkpoint.read_config(folder, AudioMotionConfig)
        weights = checkpoint.read_weights(folder)
        shapes = [
            tuple(weights[name].shape[:-1]) for name in ("sound_book", "motion_book") if name in weights
        ]
        sound, motion = shapes if len(shapes) == 2 else ((1, 1), (1, 1, 1))
        model = cls(config, sound_shape=sound, motion_shape=motion)
        checkpoint.load_into(model, weights, origin=str(folder))
        return model.eval()


def soft_labels(segments: Int[Tensor, " b"]) -> Float[Tensor, "b b"]:
    """Pairs of the same segment share the probability of each row."""
    same = (segments[:, None] == segments[None, :]).float()
    return same / same.sum(1, keepdim=True)


def info_nce(
    sounds: Float[Tensor, "b d"],
    motions: Float[Tensor, "b d"],
    temperature: Float[Tensor, ""],
    segments: Int[Tensor, " b"],
) -> Float[Tensor, ""]:
    """Bidirectional InfoNCE with soft labels (paper, equations L_a2m, L_m2a, L_CLIP)."""
    similar, labels = temperature * sounds @ motions.T, soft_labels(segments)
    forth = -(labels * similar.log_softmax(1)).sum(1).mean()
    back = -(labels * similar.T.log_softmax(1)).sum(1).mean()
    return 0.5 * (forth + back)
