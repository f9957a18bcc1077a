"""Audio encoders of the face model: the interface, our small encoder, which streams exactly, and the paper's.

Paper: multilingual HuBERT over 63 frames of sound, encoded anew for every chunk, which costs more than real time on a
CPU. `HubertEncoder` follows the release in how the window is cut, normalised and spread over frames (see `window`).

Ours (not in the paper): log-mel windows that end with their frame, and convolutions over frames. A kernel sees some
past frames, and the later frames of the same chunk, which have arrived anyway; so lips close in time for a p
without added delay.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

import numpy as np
import soxr
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from echoavatar.errors import DependencyError
from echoavatar.models.face import HubertConfig, MelConfig
from echoavatar.nn import StreamState
from echoavatar.timing import CHUNK_FRAMES, CHUNK_SAMPLES, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME, exact_div
from echoavatar_lab.nn.blocks import Mlp
from echoavatar_lab.nn.stream import StateT, StreamingModule, write_rows

_FLOOR = 1e-4  # of mel magnitudes
_WINDOW_HOPS = 4  # a window is so many hops long


@lru_cache(maxsize=16)
def mel_matrix(fft: int, bands: int) -> Float[Tensor, "f m"]:
    """Triangular filters, equal steps on the mel scale (2595 log10(1 + f / 700)) up to 12 kHz, each of sum 1."""
    top = 2595 * torch.log10(torch.tensor(1 + SAMPLE_RATE_HZ / 2 / 700, dtype=torch.float64))
    edges = 700 * (10 ** (torch.linspace(0, 1, bands + 2, dtype=torch.float64) * top / 2595) - 1)
    bins = torch.linspace(0, SAMPLE_RATE_HZ / 2, fft // 2 + 1, dtype=torch.float64)[:, None]
    low, middle, high = edges[:-2], edges[1:-1], edges[2:]
    width = SAMPLE_RATE_HZ / fft  # narrow filters are widened to one bin, so that none is empty
    rise = (bins - low + width) / (middle - low + width)
    fall = (high + width - bins) / (high - middle + width)
    filters = torch.minimum(rise, fall).clamp_min(0)
    return (filters / filters.sum(0)).float()


def fourier_matrix(size: int) -> Float[Tensor, "s f"]:
    """A Hann window and the cosines, then the sines, of the Fourier transform: one product of 32 short windows costs
    as little as their transforms, and every runtime has it.
    """
    at = torch.arange(size, dtype=torch.float64)
    phases = torch.outer(at, torch.arange(size // 2 + 1, dtype=torch.float64)) % size * (2 * math.pi / size)
    window = torch.hann_window(size, dtype=torch.float64)[:, None]
    return (window * torch.cat([phases.cos(), phases.sin()], 1)).float()


class AudioEncoder(StreamingModule[StateT]):
    """Features of the frames of 24 kHz sound."""

    @abstractmethod
    def step(self, x: Float[Tensor, "b s"], state: StateT, active: Bool[Tensor, " b"]) -> Float[Tensor, "b n c"]:
        """Features of the next chunks; the last rows are the last chunk's frames.

        An encoder that reads a whole window anew returns features of earlier frames too, in front.
        """


@dataclass
class Past(StreamState):
    """The last inputs of one convolution."""

    frames: Float[Tensor, "b p c"]


@dataclass
class MelState(StreamState):
    """All zero: silence before the start."""

    samples: Float[Tensor, "b s"]
    inputs: list[Past]


class ChunkConvolution(nn.Module):
    """x + MLP(convolution(norm(x))); the kernel covers past frames and, inside the chunk, later ones."""

    def __init__(self, *, width: int, past: int, ahead: int, chunk: int) -> None:
        super().__init__()
        self.past, self.ahead, self.chunk = past, ahead, chunk
        self.norm = nn.LayerNorm(width)
        self.mix = nn.Conv1d(width, width, past + 1 + ahead, groups=width)
        self.mlp = Mlp(inputs=width, hidden=2 * width, outputs=width)

    def step(self, x: Float[Tensor, "b t c"], state: Past, active: Bool[Tensor, " b"]) -> Float[Tensor, "b t c"]:
        """The next chunks."""
        known = torch.cat([state.frames, self.norm(x)], 1)
        starts = torch.arange(0, x.shape[1], self.chunk, device=x.device)
        reach = torch.arange(self.past + self.chunk, device=x.device)
        windows = known.index_select(1, (starts[:, None] + reach).flatten()).view(-1, len(reach), x.shape[2])
        mixed = torch.bmm(windows.permute(2, 0, 1).contiguous(), self._kernels()).permute(1, 2, 0)
        write_rows(state.frames, known[:, known.shape[1] - self.past :], active)
        bias: Tensor = self.get_parameter("mix.bias")
        y: Tensor = x + self.mlp(mixed.reshape(x.shape) + bias)
        return y

    def _kernels(self) -> Float[Tensor, "c w t"]:
        """Each channel's kernel as a matrix from a window to its chunk: a product is faster than a convolution."""
        before = self.chunk - 1  # the tap of place j for frame t is j - t
        taps = F.pad(self.mix.weight[:, 0], (before, before - self.ahead))
        return taps.unfold(1, self.chunk, 1).flip(-1)


class MelEncoder(AudioEncoder[MelState]):
    """Log-mel and `ChunkConvolution`s. `forward` is one step from a fresh state, differentiable."""

    waves: Tensor
    bands: Tensor

    def __init__(self, config: MelConfig, chunk: int = CHUNK_FRAMES) -> None:
        """`chunk`: frames that arrive together."""
        super().__init__()
        self.config, self._chunk_samples = config, chunk * SAMPLES_PER_FRAME
        self.hop = exact_div(SAMPLES_PER_FRAME, config.windows)
        size = _WINDOW_HOPS * self.hop
        self.register_buffer("waves", fourier_matrix(size), persistent=False)
        self.register_buffer("bands", mel_matrix(size, config.bands), persistent=False)
        self.inputs = nn.Linear(config.windows * config.bands, config.width)
        self.blocks = nn.ModuleList(
            ChunkConvolution(width=config.width, past=config.past, ahead=config.ahead, chunk=chunk)
            for _ in range(config.blocks)
        )
        self.output_norm = nn.LayerNorm(config.width)

    def init_state(self, rows: int) -> MelState:
        """Silence."""
        weight = self.inputs.weight.detach()
        samples = weight.new_zeros(rows, (_WINDOW_HOPS - 1) * self.hop)
        past = [Past(weight.new_zeros(rows, self.config.past, self.config.width)) for _ in self.blocks]
        return MelState(samples, past)

    def step(self, x: Float[Tensor, "b s"], state: MelState, active: Bool[Tensor, " b"]) -> Float[Tensor, "b n c"]:
        """Features of the next chunks."""
        if x.shape[1] % self._chunk_samples or not x.shape[1]:
            raise ValueError(f"a step takes a multiple of {self._chunk_samples} samples, got {x.shape[1]}")
        known = torch.cat([state.samples, x.to(state.samples)], 1)
        write_rows(state.samples, known[:, known.shape[1] - state.samples.shape[1] :], active)
        y: Tensor = self.inputs(self.log_mel(known).reshape(x.shape[0], -1, self.inputs.in_features))
        for block, past in zip(self.blocks, state.inputs, strict=True):
            assert isinstance(block, ChunkConvolution)
            y = block.step(y, past, active)
        normed: Tensor = self.output_norm(y)
        return normed

    def forward(self, x: Float[Tensor, "b s"]) -> Float[Tensor, "b n c"]:
        """A whole clip of whole chunks."""
        return self.step(x, self.init_state(len(x)), x.new_ones(len(x), dtype=torch.bool))

    def log_mel(self, known: Float[Tensor, "b s"]) -> Float[Tensor, "b k m"]:
        """About -1 (silence) to 2 (loud) per window and band; windows end every `hop` samples."""
        hops = known.unflatten(1, (-1, self.hop))  # type: ignore[no-untyped-call]
        count = hops.shape[1] - _WINDOW_HOPS + 1
        windows = torch.cat([hops[:, hop : hop + count] for hop in range(_WINDOW_HOPS)], 2)
        real, imaginary = (windows @ self.waves).chunk(2, 2)
        magnitude = torch.sqrt(real.square() + imaginary.square()) * (2 / len(self.waves))
        return (torch.log(magnitude @ self.bands + _FLOOR) + 6.5) / 2.5


RATE_HZ = 16_000
WINDOW_FRAMES = 63
_SAMPLES_PER_FRAME = RATE_HZ // 30  # 533, a third of a sample short, as in the release
_HOP = 320


@dataclass
class SoundState(StreamState):
    """The last 63 frames of sound, 24 kHz."""

    samples: Float[Tensor, "b s"]


class HubertEncoder(AudioEncoder[SoundState]):
    """transformers' HuBERT over a sliding window."""

    def __init__(self, config: HubertConfig) -> None:
        super().__init__()
        self.config = config
        self.hubert = find_transformers().HubertModel(_their_config(config))

    def train(self, mode: bool = True) -> Self:
        """A frozen network stays in evaluation mode."""
        super().train(mode)
        if not next(self.parameters()).requires_grad:
            self.hubert.eval()
        return self

    def init_state(self, rows: int) -> SoundState:
        """Silence."""
        like = next(self.parameters()).detach()
        return SoundState(like.new_zeros(rows, WINDOW_FRAMES * SAMPLES_PER_FRAME))

    def step(self, x: Float[Tensor, "b s"], state: SoundState, active: Bool[Tensor, " b"]) -> Float[Tensor, "b n c"]:
        """Features of the last 63 frames, up to the end of `x`, which is one step's sound."""
        if x.shape[1] % SAMPLES_PER_FRAME or x.shape[1] > WINDOW_FRAMES * SAMPLES_PER_FRAME:
            raise ValueError(f"a step takes whole frames, {WINDOW_FRAMES} at most; got {x.shape[1]} samples")
        known = torch.cat([state.samples, x.to(state.samples)], 1)[:, x.shape[1] :]
        write_rows(state.samples, known, active)
        return self.window(self.resample(known))

    def forward(self, x: Float[Tensor, "b s"]) -> Float[Tensor, "b n c"]:
        """Features of whole clips, as a stream would hear each chunk; for training."""
        state, active = self.init_state(len(x)), x.new_ones(len(x), dtype=torch.bool)
        parts = [self.step(part, state, active)[:, -8:] for part in torch.split(x, CHUNK_SAMPLES, dim=1)]
        return torch.cat(parts, 1)

    def window(self, audio: Float[Tensor, "b s"]) -> Float[Tensor, "b 63 c"]:
        """Features of 63 frames of 16 kHz sound: normalised over the window, 50 Hz states spread linearly."""
        audio = normalize_window(audio)[:, -WINDOW_FRAMES * _SAMPLES_PER_FRAME :]
        hidden: Tensor = self.hubert(pad_window(audio)).last_hidden_state
        spread = F.interpolate(hidden.transpose(1, 2), size=WINDOW_FRAMES, mode="linear", align_corners=False)
        return spread.transpose(1, 2)

    def resample(self, audio: Float[Tensor, "b s"]) -> Float[Tensor, "b k"]:
        """24 to 16 kHz, the whole window at once (differentiation stops here)."""
        samples = audio.detach().cpu().numpy().astype(np.float32)
        rows = [soxr.resample(row, SAMPLE_RATE_HZ, RATE_HZ) for row in samples]
        return torch.from_numpy(np.stack(rows)).to(audio)


def normalize_window(audio: Float[Tensor, "b s"]) -> Float[Tensor, "b s"]:
    """Zero mean and unit (unbiased) deviation over the window."""
    return (audio - audio.mean(1, keepdim=True)) / (audio.std(1, keepdim=True) + 1e-5)


def pad_window(audio: Float[Tensor, "b s"]) -> Float[Tensor, "b p"]:
    """Lengthen so that 50 Hz states cover the sound: reflected twice at both ends, as the release does.

    For 63 frames nothing is missing and nothing is added.
    """
    length = audio.shape[1]
    missing = -((length - 80 - _HOP * (length // _HOP)) // 2)  # ceil((320 n + 80 - length) / 2)
    if missing < 0:
        return audio
    half = missing // 2
    for _ in range(2):
        audio = F.pad(audio, (half, half), mode="reflect")
    return F.pad(audio, (1, 1), mode="replicate") if missing % 2 else audio


def find_transformers() -> Any:
    """The package of published networks. Raises DependencyError if it is not installed."""
    try:
        import transformers
    except ModuleNotFoundError as error:
        raise DependencyError(
            "published networks need transformers: pip install 'echoavatar-lab[pretrained]'"
        ) from error
    return transformers


def _their_config(config: HubertConfig) -> Any:
    return find_transformers().HubertConfig(
        hidden_size=config.width,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        intermediate_size=config.mlp,
        conv_dim=list(config.convolutions),
        num_conv_pos_embeddings=config.position_kernel,
        num_conv_pos_embedding_groups=config.position_groups,
    )
