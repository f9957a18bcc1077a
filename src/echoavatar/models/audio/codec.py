"""The causal audio codec: 24 kHz sound to 75 x 2 codes per second and back (paper, Settings: EnCodec, two layers).

The network is EnCodec's, under its published names, so that `facebook/encodec_24khz` loads where it and transformers
are at hand. May import `quantize` and below.
"""

from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.utils import parametrize

from echoavatar.errors import CheckpointError, DependencyError
from echoavatar.nn import Checkpointed, StreamingModule
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN

from .config import CODE_LAYERS, CodecConfig
from .network import decoder, encoder
from .stream import NetworkState, advance, init_network_state, shortest_start

_BLOCK_SAMPLES = 60 * SAMPLE_RATE_HZ  # `encode` works on pieces of this length, to bound its memory


class AudioCodec(Checkpointed, StreamingModule[NetworkState]):
    """Encoder, two codebooks, decoder.

    `encode` is one step from a fresh state. Departs from transformers at the end of a clip: the audio is padded
    with zeros to a whole frame once, instead of at every layer.
    """

    config_type = CodecConfig
    config: CodecConfig
    codebooks: Tensor

    def __init__(self, config: CodecConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = encoder(config)
        self.decoder = decoder(config)
        self.register_buffer("codebooks", torch.zeros(CODE_LAYERS, config.codes, config.width))
        self._shortest_start = shortest_start(self.encoder, config.padding)

    @classmethod
    def from_pretrained_encodec(cls, path_or_name: str | Path = "facebook/encodec_24khz") -> Self:
        """EnCodec as published, from a folder or the local model cache; never from the network.

        Raises:
            CheckpointError: it is not there, or is not a causal 24 kHz model.
            DependencyError: transformers is not installed.
        """
        try:
            from transformers import EncodecModel
        except ModuleNotFoundError as error:
            raise DependencyError(
                "reading a published EnCodec needs transformers: pip install 'echoavatar-lab[pretrained]'"
            ) from error
        try:
            network = EncodecModel.from_pretrained(str(path_or_name), local_files_only=True)
        except (OSError, ValueError) as error:
            raise CheckpointError(
                f"{path_or_name} is neither a folder with an EnCodec model nor in the local model cache; fetch it "
                f"with 'hf download {path_or_name}' where there is network, or use the bundled codec"
            ) from error
        _fuse_weight_norm(network)
        codec = cls(_own_config(network.config, origin=str(path_or_name)))
        codec.encoder.load_state_dict(network.encoder.state_dict())
        codec.decoder.load_state_dict(network.decoder.state_dict())
        for q in range(CODE_LAYERS):
            codec.codebooks[q] = network.quantizer.layers[q].codebook.embed
        return codec.eval()

    def init_state(self, rows: int) -> NetworkState:
        """A fresh state."""
        return init_network_state(self.encoder, rows)

    @torch.no_grad()
    def step(self, x: Float[Tensor, "b s"], state: NetworkState, active: Bool[Tensor, " b"]) -> Int[Tensor, "b n 2"]:
        """Codes of the next samples (a multiple of 320); inactive rows return codes without meaning.

        With reflection padding the first chunk of a row needs 7 frames (2,240 samples) or more.
        """
        frames, rest = divmod(x.shape[1], SAMPLES_PER_AUDIO_TOKEN)
        if rest or not frames:
            raise ValueError(f"a step takes a multiple of {SAMPLES_PER_AUDIO_TOKEN} samples, got {x.shape[1]}")
        if frames < self._shortest_start and bool((active & (state.seen == 0)).any()):
            raise ValueError(f"the first step of a row needs {self._shortest_start} frames, got {frames}")
        return self._codes(self.latents(x, state, active))

    @torch.no_grad()
    def encode(self, audio: Float[Tensor, "b s"]) -> Int[Tensor, "b n 2"]:
        """Codes (0..K-1 in each layer) of whole clips; n is s / 320, rounded up."""
        audio = F.pad(audio, (0, -audio.shape[1] % SAMPLES_PER_AUDIO_TOKEN))
        state, active = self.init_state(len(audio)), audio.new_ones(len(audio), dtype=torch.bool)
        parts = [self._codes(self.latents(part, state, active)) for part in torch.split(audio, _BLOCK_SAMPLES, dim=1)]
        return torch.cat(parts, dim=1)

    def forward(self, x: Float[Tensor, "b s"]) -> Int[Tensor, "b n 2"]:
        """`encode`."""
        return self.encode(x)

    @torch.no_grad()
    def decode(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b s"]:
        """Sound of the codes, 320 samples each; one layer of codes is enough for a coarse version."""
        return self.synthesize(self.dequantize(codes))

    def latents(
        self, audio: Float[Tensor, "b s"], state: NetworkState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b n c"]:
        """Encoder output before quantisation; differentiable from a fresh state."""
        audio = audio.to(self.codebooks)
        if not audio.shape[1]:
            return audio.new_zeros(len(audio), 0, self.config.width)
        return advance(self.encoder, audio.unsqueeze(2), state, active, padding=self.config.padding)

    def dequantize(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b n c"]:
        """Sum of the codebook vectors."""
        return torch.stack([self.codebooks[q][codes[..., q]] for q in range(codes.shape[-1])]).sum(0)

    def synthesize(self, latents: Float[Tensor, "b n c"]) -> Float[Tensor, "b s"]:
        """Decoder of latents, quantised or not."""
        if not latents.shape[1]:
            return latents.new_zeros(len(latents), 0)
        state = init_network_state(self.decoder, len(latents))
        active = state.seen == 0
        return advance(self.decoder, latents, state, active, padding=self.config.padding).squeeze(2)

    def _codes(self, latents: Float[Tensor, "b n c"]) -> Int[Tensor, "b n 2"]:
        residual, chosen = latents.double(), []
        for book in self.codebooks.double():
            codes = nearest_codes(residual, book)
            residual = residual - book[codes]
            chosen.append(codes)
        return torch.stack(chosen, dim=-1)


def nearest_codes(vectors: Float[Tensor, "b n c"], book: Float[Tensor, "k c"]) -> Int[Tensor, "b n"]:
    """Index of the nearest row of `book`.

    In |x|^2 - 2xe + |e|^2 the small differences between similar rows are lost against the large common part, so both
    sides are centred on the mean of the book first. `AudioCodec` calls this in float64, where chunked and offline
    agree.
    """
    centre = book.mean(0)
    rows = book - centre
    return (rows.square().sum(-1) - 2 * (vectors - centre) @ rows.T).argmin(-1)


def _own_config(theirs: Any, *, origin: str) -> CodecConfig:
    """Our fields of a transformers config; refuses models that cannot stream at our clock."""
    if not theirs.use_causal_conv or theirs.sampling_rate != SAMPLE_RATE_HZ or theirs.audio_channels != 1:
        raise CheckpointError(f"{origin} is not the causal, mono, 24 kHz EnCodec; use facebook/encodec_24khz")
    can_stream = theirs.norm_type == "weight_norm" and theirs.trim_right_ratio == 1.0
    if theirs.normalize or not can_stream or theirs.chunk_length_s is not None:
        raise CheckpointError(f"{origin} normalises over time and cannot stream; use facebook/encodec_24khz")
    return CodecConfig(
        filters=theirs.num_filters,
        width=theirs.hidden_size,
        codes=theirs.codebook_size,
        ratios=tuple(theirs.upsampling_ratios),
        lstm_layers=theirs.num_lstm_layers,
        residual_blocks=theirs.num_residual_layers,
        kernel=theirs.kernel_size,
        last_kernel=theirs.last_kernel_size,
        residual_kernel=theirs.residual_kernel_size,
        dilation_growth=theirs.dilation_growth_rate,
        compress=theirs.compress,
        has_conv_shortcut=theirs.use_conv_shortcut,
        padding=theirs.pad_mode,
    )


def _fuse_weight_norm(network: nn.Module) -> None:
    """Turn (direction, length) pairs into plain weights: the same function, faster."""
    for module in network.modules():
        if parametrize.is_parametrized(module):
            parametrize.remove_parametrizations(module, "weight", leave_parametrized=True)
