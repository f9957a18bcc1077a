"""Sound again from the codes of the audio codec, with the decoder that the avatar does not run."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.network import advance, init_network_state


@torch.no_grad()
def decode(codec: AudioCodec, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b s"]:
    """Sound of the codes, 320 samples each; one layer of codes is enough for a coarse version."""
    layers = zip(codec.codebooks, codes.unbind(-1), strict=False)
    return synthesize(codec, torch.stack([book[chosen] for book, chosen in layers]).sum(0))


def synthesize(codec: AudioCodec, latents: Float[Tensor, "b n c"]) -> Float[Tensor, "b s"]:
    """Decoder of latents, quantised or not; differentiable."""
    if not latents.shape[1]:
        return latents.new_zeros(len(latents), 0)
    state = init_network_state(codec.decoder, len(latents))
    active = state.seen == 0
    return advance(codec.decoder, latents, state, active, padding=codec.config.padding).squeeze(2)
