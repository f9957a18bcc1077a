"""Residual vector quantisation (paper, Motion Tokenizer): each layer quantises the remainder of those before.

z is approximated by the sum over q of z^q, each z^q taken from its own codebook C_q. `codebook_training` learns them.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn


class Codebook(nn.Module):
    """`codes` vectors of `width` channels, the nearest of which stands for an input vector."""

    codebook: Tensor

    def __init__(self, *, codes: int, width: int) -> None:
        super().__init__()
        self.register_buffer("codebook", torch.zeros(codes, width))

    def squared_distances(self, vectors: Float[Tensor, "n c"]) -> Float[Tensor, "n k"]:
        """Squared Euclidean distance of each vector to each code."""
        book = self.codebook
        return vectors.square().sum(-1, keepdim=True) - 2 * vectors @ book.T + book.square().sum(-1)

    def nearest(self, vectors: Float[Tensor, "n c"]) -> Int[Tensor, " n"]:
        """Nearest code (first index on ties)."""
        return self.squared_distances(vectors).argmin(-1)

    def lookup(self, codes: Int[Tensor, "*n"]) -> Float[Tensor, "*n c"]:
        """Vectors of the codes; a negative code (layer not sent) is the zero vector."""
        return F.embedding(codes.clamp_min(0), self.codebook) * (codes >= 0).unsqueeze(-1)


class ResidualVectorQuantizer(nn.Module):
    """`layers` codebooks of `codes` entries in `width` channels; autocast does not reach inside.

    State dict: `layers.{q}.codebook`, as in the released checkpoints.
    """

    def __init__(self, *, codes: int, width: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(Codebook(codes=codes, width=width) for _ in range(layers))

    def books(self) -> Sequence[Codebook]:
        """The codebooks, coarse to fine."""
        return [layer for layer in self.layers if isinstance(layer, Codebook)]

    def encode(self, latents: Float[Tensor, "b n c"]) -> Int[Tensor, "b n q"]:
        """The nearest codes, layer by layer."""
        chosen = []
        with torch.autocast(latents.device.type, enabled=False):
            residual = latents.detach().to(self.books()[0].codebook.dtype).flatten(0, 1)
            for book in self.books():
                chosen.append(book.nearest(residual))
                residual = residual - book.lookup(chosen[-1])
        return torch.stack(chosen, -1).view(*latents.shape[:2], -1)

    def decode(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b n c"]:
        """Sum of the layers' vectors; missing trailing layers and codes of -1 contribute nothing."""
        books = self.books()
        if codes.shape[-1] > len(books):
            raise ValueError(f"{codes.shape[-1]} layers of codes for a quantizer of {len(books)}")
        sent, known = (codes >= 0).movedim(-1, 0).unsqueeze(-1), codes.clamp_min(0).unbind(-1)
        found = [F.embedding(each, book.codebook) for each, book in zip(known, books, strict=False)]
        return (torch.stack(found) * sent).sum(0)
