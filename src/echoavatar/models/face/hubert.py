"""Multilingual HuBERT as the face model's audio encoder (paper): 63 frames of sound, encoded anew for every chunk.

The only module here that imports transformers. The published weights come from a folder or the local model cache,
never from the network. Follows the release in how the window is cut, normalised and spread over frames (see `window`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import soxr
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from echoavatar.errors import CheckpointError, DependencyError
from echoavatar.nn import StreamState, write_rows
from echoavatar.timing import CHUNK_SAMPLES, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

from .config import HubertConfig
from .encoder import AudioEncoder

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
        HubertModel = _transformers().HubertModel
        self.config = config
        self.hubert = HubertModel(_their_config(config))

    @classmethod
    def from_pretrained(cls, path_or_name: str | Path) -> Self:
        """HuBERT as published (base size), from a folder or the local model cache.

        Raises:
            CheckpointError: it is not there.
        """
        HubertModel = _transformers().HubertModel
        try:
            network = HubertModel.from_pretrained(str(path_or_name), local_files_only=True)
        except (OSError, ValueError) as error:
            raise CheckpointError(
                f"{path_or_name} is neither a folder with a HuBERT model nor in the local model cache; fetch it with "
                f"'hf download {path_or_name}' where there is network, or use the mel encoder"
            ) from error
        encoder = cls(_own_config(network.config))
        encoder.hubert.load_state_dict(network.state_dict())
        return encoder.eval()

    def freeze(self) -> None:
        """Keep the weights as they are: training then neither changes nor masks nor drops anything."""
        self.requires_grad_(False)
        self.hubert.eval()

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


def _transformers() -> Any:
    try:
        import transformers
    except ModuleNotFoundError as error:
        raise DependencyError("HuBERT needs transformers: pip install 'echoavatar-lab[pretrained]'") from error
    return transformers


def _their_config(config: HubertConfig) -> Any:
    return _transformers().HubertConfig(
        hidden_size=config.width,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        intermediate_size=config.mlp,
        conv_dim=list(config.convolutions),
        num_conv_pos_embeddings=config.position_kernel,
        num_conv_pos_embedding_groups=config.position_groups,
    )


def _own_config(theirs: Any) -> HubertConfig:
    return HubertConfig(
        width=theirs.hidden_size,
        layers=theirs.num_hidden_layers,
        heads=theirs.num_attention_heads,
        mlp=theirs.intermediate_size,
        convolutions=tuple(theirs.conv_dim),
        position_kernel=theirs.num_conv_pos_embeddings,
        position_groups=theirs.num_conv_pos_embedding_groups,
    )
