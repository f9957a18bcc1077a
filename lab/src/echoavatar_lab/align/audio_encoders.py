"""The audio encoders of the alignment reward: codec tokens, BEATs or Wav2CLIP, behind one interface.

Each takes codec tokens (75 Hz, two layers) and returns states in time. BEATs and Wav2CLIP need a waveform, which
neither token files nor continuations hold, so the codec's decoder makes one: every encoder gets the audio that the
generator gets. Training reads the same windows many times and therefore passes decoded waveforms (`decoded_waveform`).

BEATs is the paper's (Chen et al., "BEATs: Audio Pre-Training with Acoustic Tokenizers"), its weights named as
published: a transformer over patches of 16 x 16 of filter banks. Positions come from a wide grouped convolution and
from a relative attention bias, which each query scales by a gate. Layers are post-norm with DeepNorm's scaled
residuals. A classifier head in the file is ignored. Its input is Kaldi's log mel filter banks (`fbank`): 128 bands, 25
ms frames every 10 ms, audio at 16 kHz. Only whole frames count. Each frame loses its mean, is pre-emphasised and
weighted with Kaldi's own window, a Hann to the power 0.85. No dither.

The paper's retrieval table compares it with the audio network of Wav2CLIP (Wu et al., "Wav2CLIP: Learning Robust Audio
Representations from CLIP"), a ResNet-18 over the log power spectrogram of audio at 16 kHz. The published model averages
over the whole clip; here states are kept in time. Its projection to CLIP's space is not read, since the reward learns
its own.
"""

from collections.abc import Mapping
from functools import cache
from typing import Self

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from pydantic import Field, model_validator
from torch import Tensor, nn

from echoavatar.config import Config
from echoavatar.errors import CheckpointError
from echoavatar.models.audio import CodecConfig
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN, SAMPLES_PER_MOTION_TOKEN, exact_div
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.decoding import decode
from echoavatar_lab.nn.blocks import FullBlock

RATE_HZ = 16_000
BANDS = 128
FBANK_FRAME, FBANK_STEP = 400, 160
FBANK_SPECTRUM = 512
PRE_EMPHASIS = 0.97
LOWEST_HZ = 20.0
FBANK_MEAN, FBANK_STD = 15.41663, 6.55582  # of BEATs' training audio; BEATs divides by twice the deviation
FULL_SCALE = 2.0**15


def fbank(wave: Float[Tensor, "b s"]) -> Float[Tensor, "b t 128"]:
    """Log energies of the bands, normalised for BEATs; `wave` lies within -1 and 1."""
    frames = (wave * FULL_SCALE).unfold(1, FBANK_FRAME, FBANK_STEP)
    frames = frames - frames.mean(-1, keepdim=True)
    before = torch.cat([frames[..., :1], frames[..., :-1]], -1)
    window = torch.hann_window(FBANK_FRAME, periodic=False, dtype=torch.float64) ** 0.85
    window, bands = window.to(wave), _bands().to(wave)
    power = torch.fft.rfft((frames - PRE_EMPHASIS * before) * window, n=FBANK_SPECTRUM).abs().square()
    energies = power[..., : FBANK_SPECTRUM // 2] @ bands
    logs: Tensor = energies.clamp(min=torch.finfo(torch.float32).eps).log()
    return (logs - FBANK_MEAN) / (2 * FBANK_STD)


def _mel(hertz: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    return 1127 * torch.log1p(hertz / 700)


@cache
def _bands() -> Float[Tensor, "k 128"]:
    """Triangular filters, two bands wide in mel; the Nyquist bin is left out, as in Kaldi."""
    low, high = (float(_mel(torch.tensor(hertz, dtype=torch.float64))) for hertz in (LOWEST_HZ, RATE_HZ / 2))
    width = (high - low) / (BANDS + 1)
    centres = low + width * torch.arange(1, BANDS + 1, dtype=torch.float64)
    bins = _mel(torch.arange(FBANK_SPECTRUM // 2, dtype=torch.float64) * RATE_HZ / FBANK_SPECTRUM)
    return F.relu(1 - (bins[:, None] - centres).abs() / width)


PATCH = 16
GATES = 8  # values computed from a query for its two gates
SHARED_BIAS = "self_attn.relative_attention_bias.weight"  # one for all layers; stored once a layer


class BeatsConfig(Config):
    """Model sizes; the defaults are the published model's."""

    layers: int = Field(default=12, gt=0, description="transformer layers")
    width: int = Field(default=768, gt=0, description="channels")
    heads: int = Field(default=12, gt=0, description="attention heads")
    hidden: int = Field(default=3072, gt=0, description="channels inside the MLPs")
    patch_width: int = Field(default=512, gt=0, description="channels of a patch before projection")
    buckets: int = Field(default=320, gt=0, description="distances that the attention bias distinguishes")
    farthest: int = Field(default=800, gt=0, description="distance beyond which all share one bucket")
    reach: int = Field(default=128, gt=0, description="patches that the positional convolution spans")
    groups: int = Field(default=16, gt=0, description="groups of the positional convolution")


class PositionConv(nn.Module):
    """Positional convolution with weight normalisation: a magnitude for each tap times a direction."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.groups, self.reach = config.groups, config.reach
        shape = (config.width, config.width // config.groups, config.reach)
        self.weight_g = nn.Parameter(torch.ones(1, 1, config.reach))
        self.weight_v = nn.Parameter(torch.randn(shape) * (4 / (config.reach * config.width)) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(config.width))

    def forward(self, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """Keeps the length; an even kernel reaches one patch further back than ahead."""
        weight = self.weight_g * self.weight_v / self.weight_v.norm(dim=(0, 1), keepdim=True)
        y = F.conv1d(x.transpose(1, 2), weight, self.bias, padding=self.reach // 2, groups=self.groups)
        return F.gelu(y[..., : x.shape[1]]).transpose(1, 2)


class GatedAttention(nn.Module):
    """Attention with a relative position bias that each query gates."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        width, self.heads = config.width, config.heads
        self.q_proj, self.k_proj, self.v_proj, self.out_proj = (nn.Linear(width, width) for _ in range(4))
        self.grep_linear = nn.Linear(width // config.heads, GATES)
        self.grep_a = nn.Parameter(torch.ones(1, config.heads, 1, 1))

    def forward(self, x: Float[Tensor, "b n c"], bias: Float[Tensor, "h n n"]) -> Float[Tensor, "b n c"]:
        """Every patch attends to every patch."""
        q, k, v = (
            part(x).unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in (self.q_proj, self.k_proj, self.v_proj)
        )
        gates = self.grep_linear(q).unflatten(-1, (2, GATES // 2)).sum(-1).sigmoid()
        gate = gates[..., :1] * (gates[..., 1:] * self.grep_a - 1) + 2
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=gate * bias)
        y: Tensor = self.out_proj(mixed.transpose(1, 2).flatten(2))
        return y


class BeatsLayer(nn.Module):
    """Post-norm attention and MLP; the residual branch is scaled by `residual`."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.residual = (2 * config.layers) ** 0.25
        self.self_attn = GatedAttention(config)
        self.self_attn_layer_norm, self.final_layer_norm = (nn.LayerNorm(config.width) for _ in range(2))
        self.fc1 = nn.Linear(config.width, config.hidden)
        self.fc2 = nn.Linear(config.hidden, config.width)

    def forward(self, x: Float[Tensor, "b n c"], bias: Float[Tensor, "h n n"]) -> Float[Tensor, "b n c"]:
        """States after this layer."""
        x = self.self_attn_layer_norm(self.residual * x + self.self_attn(x, bias))
        y: Tensor = self.final_layer_norm(self.residual * x + self.fc2(F.gelu(self.fc1(x))))
        return y


class BeatsEncoder(nn.Module):
    """The positional convolution and the transformer layers."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.config = config
        self.pos_conv = nn.Sequential(PositionConv(config))
        self.layers = nn.ModuleList(BeatsLayer(config) for _ in range(config.layers))
        self.layers[0].self_attn.relative_attention_bias = nn.Embedding(config.buckets, config.heads)  # type: ignore[union-attr]
        self.layer_norm = nn.LayerNorm(config.width)

    def forward(self, x: Float[Tensor, "b n c"]) -> Float[Tensor, "b n c"]:
        """States of the patches."""
        x = self.layer_norm(x + self.pos_conv(x))
        table: nn.Embedding = self.layers[0].self_attn.relative_attention_bias  # type: ignore[assignment,union-attr]
        near = _relative_buckets(x.shape[1], self.config.buckets, self.config.farthest).to(x.device)
        bias = table(near).permute(2, 0, 1)
        for layer in self.layers:
            x = layer(x, bias)
        return x


class Beats(nn.Module):
    """Audio at 16 kHz in, one state every 160 ms out."""

    def __init__(self, config: BeatsConfig) -> None:
        super().__init__()
        self.config = config
        self.patch_embedding = nn.Conv2d(1, config.patch_width, PATCH, stride=PATCH, bias=False)
        self.layer_norm = nn.LayerNorm(config.patch_width)
        self.post_extract_proj = nn.Linear(config.patch_width, config.width)
        self.encoder = BeatsEncoder(config)

    def patches(self, wave: Float[Tensor, "b s"]) -> Float[Tensor, "b n c"]:
        """States of all patches; those of one time step are adjacent, low bands first."""
        cut = self.patch_embedding(fbank(wave)[:, None]).flatten(2).transpose(1, 2)
        states: Tensor = self.encoder(self.post_extract_proj(self.layer_norm(cut)))
        return states

    def forward(self, wave: Float[Tensor, "b s"]) -> Float[Tensor, "b t c"]:
        """States in time, averaged over the frequency bands."""
        states = self.patches(wave)
        return states.view(len(states), -1, BANDS // PATCH, states.shape[2]).mean(2)

    @classmethod
    def from_published(cls, tensors: Mapping[str, Tensor]) -> Self:
        """Build from the tensors under `model` in a published file; sizes follow from their shapes.

        Raises CheckpointError: the tensors belong to another model.
        """
        kept = {
            name: value
            for name, value in tensors.items()
            if not name.startswith("predictor") and (SHARED_BIAS not in name or ".layers.0." in name)
        }
        try:
            table = kept[f"encoder.layers.0.{SHARED_BIAS}"]
            taps = kept["encoder.pos_conv.0.weight_v"]
            hidden, width = kept["encoder.layers.0.fc1.weight"].shape
            config = BeatsConfig(
                layers=1 + max(int(name.split(".")[2]) for name in kept if ".layers." in name),
                width=width,
                heads=table.shape[1],
                hidden=hidden,
                patch_width=kept["patch_embedding.weight"].shape[0],
                buckets=table.shape[0],
                reach=taps.shape[2],
                groups=width // taps.shape[1],
            )
            model = cls(config)
            model.load_state_dict(kept)
        except (KeyError, ValueError, RuntimeError) as error:
            raise _foreign_weights(error, "BEATs", "a file such as BEATs_iter3_plus_AS2M.pt") from error
        return model.eval()


def _foreign_weights(error: Exception, name: str, remedy: str) -> CheckpointError:
    reason = str(error).split("\n")[-1].strip()[:160]
    return CheckpointError(f"these are not {name} weights ({reason}); use {remedy}")


def _relative_buckets(length: int, buckets: int, farthest: int) -> Int[Tensor, "n n"]:
    """Bucket of each distance: exact up close, logarithmic further away; the upper half of the buckets looks ahead."""
    at = torch.arange(length)
    ahead = at[None, :] - at[:, None]
    half = buckets // 2
    exact = half // 2
    far = ahead.abs()
    grown = exact + (torch.log(far.clamp(min=1) / exact) / torch.log(torch.tensor(farthest / exact)) * (half - exact))
    found = torch.where(far < exact, far, grown.long().clamp(max=half - 1))
    return found + half * (ahead > 0)


WAV2CLIP_FRAME, WAV2CLIP_STEP = 512, 353  # samples of a frame, and from one to the next
QUIET = 1e-7
STAGES = 4
_PREFIX = "audio_encoder."


class Wav2ClipConfig(Config):
    """Model sizes; the defaults are the published model's."""

    width: int = Field(default=64, gt=0, description="channels of the first stage; each further stage doubles them")
    blocks: int = Field(default=2, gt=0, description="residual blocks a stage")


class Block(nn.Module):
    """Two 3 x 3 convolutions with a residual connection."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: Float[Tensor, "b c f t"]) -> Float[Tensor, "b d g u"]:
        """Output of one block."""
        y = self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x)))))
        out: Tensor = F.relu(y + self.downsample(x))
        return out


class Wav2Clip(nn.Module):
    """Audio at 16 kHz in, one state every 0.7 s out."""

    def __init__(self, config: Wav2ClipConfig) -> None:
        super().__init__()
        self.config = config
        self.conv1 = nn.Conv2d(1, config.width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(config.width)
        inputs = config.width
        for stage in range(STAGES):
            outputs = config.width << stage
            blocks = [Block(inputs, outputs, 1 if stage == 0 else 2)]
            blocks += [Block(outputs, outputs, 1) for _ in range(config.blocks - 1)]
            setattr(self, f"layer{stage + 1}", nn.Sequential(*blocks))
            inputs = outputs

    @property
    def width(self) -> int:
        """Channels of a state."""
        return self.config.width << (STAGES - 1)

    def forward(self, wave: Float[Tensor, "b s"]) -> Float[Tensor, "b t c"]:
        """States in time, averaged over frequencies."""
        x = F.relu(self.bn1(self.conv1(spectrogram(wave)[:, None])))
        x = F.max_pool2d(x, 3, stride=2, padding=1)
        for stage in range(STAGES):
            x = getattr(self, f"layer{stage + 1}")(x)
        states: Tensor = x.mean(2).transpose(1, 2)
        return states

    @classmethod
    def from_published(cls, tensors: Mapping[str, Tensor]) -> Self:
        """Build from the tensors under `state_dict` in a published file; sizes follow from their shapes.

        Raises CheckpointError: the tensors belong to another model.
        """
        kept = {
            name.removeprefix(_PREFIX): value
            for name, value in tensors.items()
            if name.startswith(_PREFIX) and not name.startswith((f"{_PREFIX}spectrogram.", f"{_PREFIX}fc."))
        }
        try:
            blocks = 1 + max(int(name.split(".")[1]) for name in kept if name.startswith("layer1."))
            model = cls(Wav2ClipConfig(width=kept["conv1.weight"].shape[0], blocks=blocks))
            model.load_state_dict(kept)
        except (KeyError, ValueError, RuntimeError) as error:
            raise _foreign_weights(error, "Wav2CLIP", "its ResNet_CX.ckpt") from error
        return model.eval()


def spectrogram(wave: Float[Tensor, "b s"]) -> Float[Tensor, "b 257 t"]:
    """Log power, normalised to mean 0 and deviation 1 over each clip.

    The published code normalises over the whole batch; here the result does not depend on the other clips in it.
    """
    window = torch.hann_window(WAV2CLIP_FRAME, device=wave.device)
    spectrum = torch.stft(wave, WAV2CLIP_FRAME, WAV2CLIP_STEP, window=window, return_complex=True)
    logs = (spectrum.abs().square() + QUIET).log()
    mean, deviation = logs.mean((1, 2), keepdim=True), logs.std((1, 2), keepdim=True)
    return (logs - mean) / (deviation + 1e-9)


TOKENS_PER_STATE = exact_div(SAMPLES_PER_MOTION_TOKEN, 2 * SAMPLES_PER_AUDIO_TOKEN)  # 5 audio tokens a state: 15 Hz
KINDS = ("codes", "beats", "wav2clip")
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
    sound = decode(codec, codes)
    samples = sound.shape[1] * RATE_HZ // SAMPLE_RATE_HZ
    spectrum = torch.fft.rfft(sound.float())[:, : samples // 2 + 1]
    wave: Tensor = torch.fft.irfft(spectrum, n=samples) * (RATE_HZ / SAMPLE_RATE_HZ)
    return wave
