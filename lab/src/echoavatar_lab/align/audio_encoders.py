"""The audio encoders of the alignment reward: codec tokens, BEATs or Wav2CLIP, behind one interface.

Each takes codec tokens (75 Hz, two layers) and returns states in time. BEATs and Wav2CLIP need a waveform, which
neither token files nor continuations hold, so the codec's decoder makes one: every encoder gets the audio that the
generator gets. Training reads the same windows many times and therefore passes decoded waveforms (`decoded_waveform`).
"""

from typing import Literal, Self, get_args

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.models.audio import AudioCodec, CodecConfig
from echoavatar.nn import FullBlock
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN, SAMPLES_PER_MOTION_TOKEN, exact_div

from .beats_encoder import Beats, BeatsConfig
from .fbank import RATE_HZ
from .wav2clip import Wav2Clip, Wav2ClipConfig

TOKENS_PER_STATE = exact_div(SAMPLES_PER_MOTION_TOKEN, 2 * SAMPLES_PER_AUDIO_TOKEN)  # 5 audio tokens a state: 15 Hz
Kind = Literal["codes", "beats", "wav2clip"]
KINDS: tuple[str, ...] = get_args(Kind)
SMALL_BEATS = BeatsConfig(layers=2, width=96, heads=4, hidden=192, patch_width=96, reach=32, groups=4)
SMALL_WAV2CLIP = Wav2ClipConfig(width=16, blocks=1)


class AudioEncoderConfig(Config):
    """Which encoder: codec tokens unless `beats` or `wav2clip` is given, which also need the codec."""

    beats: BeatsConfig | None = Field(default=None, description="sizes of BEATs")
    wav2clip: Wav2ClipConfig | None = Field(default=None, description="sizes of Wav2CLIP's network")
    codec: CodecConfig | None = Field(default=None, description="codec whose decoder makes the waveform")
    is_frozen: bool = Field(default=False, description="keep the network's weights fixed")
    channels: int = Field(default=0, ge=0, description="codes: length of a code vector, codec layers summed")
    layers: int = Field(default=2, gt=0, description="codes: transformer layers")

    @model_validator(mode="after")
    def _waves_need_a_codec(self) -> Self:
        if self.beats and self.wav2clip:
            raise ValueError("the audio encoder is BEATs or Wav2CLIP, not both")
        if bool(self.beats or self.wav2clip) != bool(self.codec):
            raise ValueError("BEATs and Wav2CLIP need a codec; codes must have none")
        return self

    @property
    def kind(self) -> Kind:
        """The encoder's name."""
        return "beats" if self.beats else "wav2clip" if self.wav2clip else "codes"


class TokenEncoder(nn.Module):
    """Code vectors at 75 Hz, strided convolution to 15 Hz, then attention; trained with the reward."""

    book: Tensor

    def __init__(self, config: AudioEncoderConfig, shape: tuple[int, ...], *, width: int, heads: int) -> None:
        """`shape` is (layers, codes) of the codec."""
        super().__init__()
        self.register_buffer("book", torch.zeros(*shape, config.channels))
        self.before = nn.Conv1d(config.channels, width, 3, padding=1)
        self.down = nn.Conv1d(width, width, TOKENS_PER_STATE, stride=TOKENS_PER_STATE)
        self.blocks = nn.Sequential(*(FullBlock(width=width, heads=heads) for _ in range(config.layers)))

    def forward(self, codes: Int[Tensor, "b f l"]) -> Float[Tensor, "b t c"]:
        """States at 15 Hz."""
        x = torch.stack([self.book[layer][codes[..., layer]] for layer in range(codes.shape[2])]).sum(0)
        y = F.gelu(self.before(x.transpose(1, 2)))
        y = self.down(y).transpose(1, 2)
        states: Tensor = self.blocks(y + sinusoids(y.shape[1], y.shape[2]).to(y))
        return states


class WaveformEncoder(nn.Module):
    """BEATs or Wav2CLIP over the codec's decoder, then a linear projection."""

    def __init__(self, config: AudioEncoderConfig, *, width: int) -> None:
        super().__init__()
        self.is_frozen = config.is_frozen
        assert config.codec is not None
        self.codec = AudioCodec(config.codec).requires_grad_(False)
        self.network: Beats | Wav2Clip
        if config.beats is not None:
            self.network, inputs = Beats(config.beats), config.beats.width
        else:
            assert config.wav2clip is not None
            self.network = Wav2Clip(config.wav2clip)
            inputs = self.network.width
        self.network.requires_grad_(not config.is_frozen)
        self.out = nn.Linear(inputs, width)

    def train(self, mode: bool = True) -> Self:
        """A frozen network stays in evaluation mode, so that its running averages do not change."""
        super().train(mode)
        self.codec.eval()
        if self.is_frozen:
            self.network.eval()
        return self

    def forward(self, sound: Tensor) -> Float[Tensor, "b t c"]:
        """States of codec tokens (b, f, l), or of a waveform at 16 kHz (b, s)."""
        wave = sound if sound.is_floating_point() else decoded_waveform(self.codec, sound)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.is_frozen):
            states = self.network(wave)
        projected: Tensor = self.out(states)
        return projected


def sinusoids(length: int, width: int) -> Float[Tensor, "t c"]:
    """Sinusoidal position encoding (paper, Audio-Motion Alignment Reward: PE)."""
    rates = 10_000.0 ** (-torch.arange(0, width, 2) / width)
    angles = torch.arange(length)[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(1)[:, :width]


@torch.no_grad()
def decoded_waveform(codec: AudioCodec, codes: Int[Tensor, "b f l"]) -> Float[Tensor, "b s"]:
    """Decode codec tokens to 16 kHz audio; frequencies above 8 kHz are cut off in the spectrum."""
    sound = codec.decode(codes)
    samples = sound.shape[1] * RATE_HZ // SAMPLE_RATE_HZ
    spectrum = torch.fft.rfft(sound.float())[:, : samples // 2 + 1]
    wave: Tensor = torch.fft.irfft(spectrum, n=samples) * (RATE_HZ / SAMPLE_RATE_HZ)
    return wave
