"""The causal audio codec: 24 kHz sound to 75 x 2 codes per second (paper, Settings: EnCodec, two layers).

The network is EnCodec's, under its published names, so that `facebook/encodec_24khz` can be converted. `decoding` runs
the decoder, back to sound.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.models.audio.codec_config import CODE_LAYERS, CodecConfig
from echoavatar.timing import SAMPLE_RATE_HZ, SAMPLES_PER_AUDIO_TOKEN
from echoavatar_lab.checkpoint import Checkpointed
from echoavatar_lab.models.audio.network import (
    NetworkState,
    advance,
    decoder,
    encoder,
    init_network_state,
    shortest_start,
)
from echoavatar_lab.nn.stream import StreamingModule

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

    def latents(
        self, audio: Float[Tensor, "b s"], state: NetworkState, active: Bool[Tensor, " b"]
    ) -> Float[Tensor, "b n c"]:
        """Encoder output before quantisation; differentiable from a fresh state."""
        audio = audio.to(self.codebooks)
        if not audio.shape[1]:
            return audio.new_zeros(len(audio), 0, self.config.width)
        return advance(self.encoder, audio.unsqueeze(2), state, active, padding=self.config.padding)

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
