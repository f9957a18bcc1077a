"""Residual vector quantisation (paper, Motion Tokenizer): each layer quantises the remainder of those before.

z is approximated by the sum over q of z^q, each z^q taken from its own codebook.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from .codebook import Codebook, Share
from .steady import steadiest


class Quantized(NamedTuple):
    """Result of one training pass.

    `latents` carry the gradient straight through; `codes` are -1 where quantiser dropout skipped a layer;
    `commitment` is the mean over the layers used of the mean squared distance to the code.
    """

    latents: Float[Tensor, "b n c"]
    codes: Int[Tensor, "b n q"]
    commitment: Float[Tensor, ""]


class ResidualVectorQuantizer(nn.Module):
    """`layers` codebooks of `codes` entries in `width` channels; autocast does not reach inside.

    State dict: `layers.{q}.codebook`, as in the released checkpoints. Departs from the release in the
    straight-through estimator, taken once over the sum (theirs, once per layer, multiplies the encoder's
    gradient by the number of layers).
    """

    def __init__(
        self,
        *,
        codes: int,
        width: int,
        layers: int,
        decay: float = 0.99,
        dead_below: float = 1.0,
        kmeans_steps: int = 0,
    ) -> None:
        super().__init__()
        self.codes = codes
        self.width = width
        self.layers = nn.ModuleList(
            Codebook(codes=codes, width=width, decay=decay, dead_below=dead_below, kmeans_steps=kmeans_steps)
            for _ in range(layers)
        )

    @property
    def depth(self) -> int:
        """Number of layers Q."""
        return len(self.layers)

    def books(self) -> list[Codebook]:
        """The codebooks, coarse to fine."""
        return [layer for layer in self.layers if isinstance(layer, Codebook)]

    def encode(self, latents: Float[Tensor, "b n c"], patience: float = 0.0) -> Int[Tensor, "b n q"]:
        """Codes layer by layer: the nearest entries, or with `patience` the steadiest good ones of whole clips.

        A change of code then costs `patience` times the layer's mean error with the nearest entries.
        """
        residual = latents.detach().to(self._dtype()).flatten(0, 1)
        chosen = []
        with torch.autocast(latents.device.type, enabled=False):
            for book in self.books():
                codes = book.nearest(residual)
                if patience:
                    distances = book.squared_distances(residual).view(*latents.shape[:2], -1)
                    prices = patience * distances.min(-1).values.mean(1)
                    codes = torch.cat([steadiest(*clip) for clip in zip(distances, prices, strict=True)])
                residual = residual - book.lookup(codes)
                chosen.append(codes)
        return torch.stack(chosen, -1).view(*latents.shape[:2], -1)

    def decode(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b n c"]:
        """Sum of the layers' vectors; missing trailing layers and codes of -1 contribute nothing."""
        if codes.shape[-1] > self.depth:
            raise ValueError(f"{codes.shape[-1]} layers of codes for a quantizer of {self.depth}")
        books = self.books()[: codes.shape[-1]]
        return torch.stack([book.lookup(codes[..., q]) for q, book in enumerate(books)]).sum(0)

    def forward(
        self,
        latents: Float[Tensor, "b n c"],
        *,
        temperature: float = 0.0,
        dropout: float = 0.0,
        generator: torch.Generator | None = None,
        share: Share | None = None,
    ) -> Quantized:
        """Quantise for training: in train mode the codebooks initialise themselves, learn, revive dead codes.

        Args:
            latents: what to quantise.
            temperature: > 0 draws codes by Gumbel noise on -distance^2 / temperature (release: 0.5).
            dropout: probability that this batch uses only a random number of leading layers (release: 0.2).
            generator: source of all randomness; None: the global one, and first vectors for initialisation.
            share: these are some rows of a batch; the codebooks learn when `settle` is called after its last.
        """
        if share is not None:
            share = Share(share.first * latents.shape[1], share.of * latents.shape[1])
        with torch.autocast(latents.device.type, enabled=False):
            flat = latents.to(self._dtype()).flatten(0, 1)
            used = self._layers_used(dropout, generator)
            residual = flat
            losses: list[Tensor] = []
            chosen: list[Tensor] = []
            for q, book in enumerate(self.books()):
                if q >= used:
                    chosen.append(torch.full_like(chosen[0], -1))
                    continue
                codes, vectors = self._one_layer(book, residual.detach(), temperature, generator, share)
                losses.append(F.mse_loss(residual, vectors))
                residual = residual - vectors
                chosen.append(codes)
            summed = flat - residual.detach()
            straight = flat + (summed - flat).detach()
        return Quantized(
            straight.view(latents.shape),
            torch.stack(chosen, -1).view(*latents.shape[:2], -1),
            torch.stack(losses).mean(),
        )

    @torch.no_grad()
    def initialise(self, latents: Float[Tensor, "n c"], generator: torch.Generator | None = None) -> None:
        """Initialise all codebooks from many latents, layer by layer on the remainder.

        Ours, for short runs: `forward` would take them from the first batch alone.
        """
        residual = latents.to(self._dtype())
        for book in self.books():
            book.initialise(residual, generator)
            residual = residual - book.lookup(book.nearest(residual))

    @property
    def is_ready(self) -> bool:
        """Whether all codebooks have been initialised."""
        return all(bool(book.ready) for book in self.books())

    def settle(self, gather: Callable[[Tensor], Tensor], generator: torch.Generator | None = None) -> None:
        """Update the codebooks with a batch whose rows, of all processes (`gather`), have passed with a `share`."""
        for book in self.books():
            book.settle(gather, generator)

    def training_state(self) -> dict[str, Tensor]:
        """Moving averages of all layers (`layers.{q}.sums`, ...), for an exact resume."""
        return {
            f"layers.{q}.{name}": value
            for q, book in enumerate(self.books())
            for name, value in book.training_state().items()
        }

    def load_training_state(self, state: dict[str, Tensor]) -> None:
        """Take over `training_state`; call it after `load_state_dict`."""
        for q, book in enumerate(self.books()):
            book.load_training_state({name: state[f"layers.{q}.{name}"] for name in book.training_state()})

    def _one_layer(
        self,
        book: Codebook,
        residual: Tensor,
        temperature: float,
        generator: torch.Generator | None,
        share: Share | None,
    ) -> tuple[Tensor, Tensor]:
        learns = self.training and torch.is_grad_enabled()
        if learns and not bool(book.ready):
            book.initialise(residual, generator)
        temperature = temperature if self.training else 0.0
        codes = book.nearest(residual, temperature=temperature, generator=generator, share=share)
        vectors = book.lookup(codes)
        if learns and share is not None:
            book.keep(residual, codes)
        elif learns:
            book.update(residual, codes, generator)
        return codes, vectors

    def _dtype(self) -> torch.dtype:
        return self.books()[0].codebook.dtype

    def _layers_used(self, dropout: float, generator: torch.Generator | None) -> int:
        if not self.training or dropout <= 0:
            return self.depth
        chance, place = torch.rand(2, generator=generator, device=generator.device if generator else None).tolist()
        return 1 + int(place * self.depth) if chance < dropout else self.depth
