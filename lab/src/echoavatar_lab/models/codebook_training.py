"""Codebooks that learn, and steady codes.

A codebook is learned by moving averages (paper, Motion Tokenizer). The averages (sums, counts) are buffers and can be
saved (`training_state`), so that training resumes exactly; the state dict leaves them out, so that a learned quantiser
loads as a plain one.

A batch that is trained in pieces, or by several processes, must update a codebook as one batch: noise is drawn for the
whole batch and cut (`Share`), and the updates of the pieces are kept (`keep`) until all have passed (`settle`).

Steady codes (`steadiest`) are the cheapest sequence for a clip when every change of code has a price. Near the border
of two codes a vector flips from one to the other and back. The flips hardly change the decoded motion, but a generator
has to predict each of them, and they hide the changes that matter. So the motion that a generator learns from is
encoded as video is, by distortion plus rate (Potts model, solved exactly by dynamic programming). Not in the paper.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar_lab.models.quantize import Codebook, ResidualVectorQuantizer
from echoavatar_lab.models.tokenizer.model import BodyTokenizer


class Share(NamedTuple):
    """The position of some vectors in their batch: from `first` on, out of `of`."""

    first: int
    of: int


class LearningCodebook(Codebook):
    """A codebook with its moving averages.

    Departures from the released recipe: k-means steps after the first-batch initialisation, a lower
    threshold for dead codes (both off by default); a revived code starts with the count of a fresh one, so
    that it is not dropped again at once.
    """

    sums: Tensor
    counts: Tensor
    ready: Tensor

    def __init__(
        self, *, codes: int, width: int, decay: float = 0.99, dead_below: float = 1.0, kmeans_steps: int = 0
    ) -> None:
        super().__init__(codes=codes, width=width)
        self.codes, self.width = codes, width
        self.decay, self.dead_below, self.kmeans_steps = decay, dead_below, kmeans_steps
        self.register_buffer("sums", torch.zeros(codes, width), persistent=False)
        self.register_buffer("counts", torch.zeros(codes), persistent=False)
        self.register_buffer("ready", torch.zeros((), dtype=torch.bool), persistent=False)
        self._kept: list[tuple[Tensor, Tensor]] = []
        self.register_load_state_dict_post_hook(_adopt_loaded)  # type: ignore[no-untyped-call]

    def nearest(
        self,
        vectors: Float[Tensor, "n c"],
        *,
        temperature: float = 0.0,
        generator: torch.Generator | None = None,
        share: Share | None = None,
    ) -> Int[Tensor, " n"]:
        """Nearest code (first index on ties); a temperature adds Gumbel noise to -d^2 / temperature."""
        distances = self.squared_distances(vectors)
        if temperature <= 0:
            return distances.argmin(-1)
        first, of = share or Share(0, len(distances))
        device = distances.device if generator is None else generator.device
        uniform = torch.rand(of, self.codes, generator=generator, device=device)
        uniform = uniform[first : first + len(distances)].to(distances).clamp_min(1e-20)
        return (-distances / temperature - (-uniform.log()).clamp_min(1e-20).log()).argmax(-1)

    @torch.no_grad()
    def initialise(self, vectors: Float[Tensor, "n c"], generator: torch.Generator | None = None) -> None:
        """Take the codes from a batch: its first vectors (random with a generator), then k-means steps."""
        self.codebook.copy_(self._draw(vectors, generator))
        for _ in range(self.kmeans_steps):
            sums, counts = self._totals(vectors, self.nearest(vectors))
            hit = counts > 0
            self.codebook[hit] = sums[hit] / counts[hit, None]
        self.sums.copy_(self.codebook)
        self.counts.fill_(1)
        self.ready.fill_(True)

    @torch.no_grad()
    def update(
        self, vectors: Float[Tensor, "n c"], codes: Int[Tensor, " n"], generator: torch.Generator | None = None
    ) -> Bool[Tensor, " k"]:
        """One moving-average step towards the vectors each code stood for; returns the revived codes."""
        sums, counts = self._totals(vectors, codes)
        self.sums.mul_(self.decay).add_(sums, alpha=1 - self.decay)
        self.counts.mul_(self.decay).add_(counts, alpha=1 - self.decay)
        is_dead = self.counts < self.dead_below
        if bool(is_dead.any()):
            self.sums[is_dead] = self._draw(vectors, generator)[is_dead]
            self.counts[is_dead] = 1
        self.codebook.copy_(self.sums / self.counts[:, None])
        return is_dead

    def keep(self, vectors: Float[Tensor, "n c"], codes: Int[Tensor, " n"]) -> None:
        """Keep an `update` until the rest of the batch is there."""
        self._kept.append((vectors.detach(), codes))

    def settle(
        self, gather: Callable[[Tensor], Tensor], generator: torch.Generator | None = None
    ) -> Bool[Tensor, " k"] | None:
        """`update` with everything kept by all processes (`gather`, in order of the batch); None without any."""
        if not self._kept:
            return None
        vectors, codes = (gather(torch.cat(parts)) for parts in zip(*self._kept, strict=True))
        self._kept.clear()
        return self.update(vectors, codes, generator)

    def training_state(self) -> dict[str, Tensor]:
        """The moving averages, which the state dict leaves out and an exact resume needs."""
        return {"sums": self.sums, "counts": self.counts, "ready": self.ready}

    def _totals(self, vectors: Tensor, codes: Tensor) -> tuple[Tensor, Tensor]:
        sums = torch.zeros_like(self.codebook).index_add_(0, codes, vectors.to(self.codebook))
        counts = torch.bincount(codes, minlength=self.codes).to(self.counts)
        return sums, counts

    def _draw(self, vectors: Tensor, generator: torch.Generator | None) -> Tensor:
        """As many batch vectors as there are codes; repeated ones get a little noise."""
        vectors = vectors.to(self.codebook)
        count = len(vectors)
        if generator is not None:
            order = torch.randperm(count, generator=generator, device=generator.device).to(vectors.device)
            vectors = vectors[order]
        if count >= self.codes:
            return vectors[: self.codes]
        tiled: Tensor = vectors.repeat(-(-self.codes // count), 1)[: self.codes]
        device = tiled.device if generator is None else generator.device
        noise = torch.randn(tiled.shape, generator=generator, device=device)
        return tiled + noise.to(tiled) * (0.01 / math.sqrt(self.width))


def _adopt_loaded(module: nn.Module, incompatible: object) -> None:
    """A loaded codebook counts as initialised: its averages start at the codes themselves."""
    del incompatible
    assert isinstance(module, LearningCodebook)
    module.sums.copy_(module.codebook)
    module.counts.fill_(1)
    module.ready.fill_(True)


def steadiest(distances: Float[Tensor, "n k"], price: Float[Tensor, ""] | float) -> Int[Tensor, " n"]:
    """The codes with the least sum of their distances and of `price` for every change; price 0 takes the nearest."""
    steps, codes = distances.shape
    same = torch.arange(codes, device=distances.device)
    came = same.repeat(steps, 1)  # at each step, the code before on the cheapest way to each code
    cost = distances[0].clone()
    for step in range(1, steps):
        cheapest, other = cost.min(0)
        stays = cost <= cheapest + price
        came[step] = torch.where(stays, same, other)
        cost = torch.where(stays, cost, cheapest + price) + distances[step]
    path = [int(cost.argmin())]
    for before in came[1:].flip(0):
        path.append(int(before[path[-1]]))
    return torch.tensor(path[::-1], device=distances.device)


class Quantized(NamedTuple):
    """Result of one training pass.

    `latents` carry the gradient straight through; `codes` are -1 where quantiser dropout skipped a layer;
    `commitment` is the mean over the layers used of the mean squared distance to the code.
    """

    latents: Float[Tensor, "b n c"]
    codes: Int[Tensor, "b n q"]
    commitment: Float[Tensor, ""]


class LearningQuantizer(ResidualVectorQuantizer):
    """A quantiser whose codebooks learn.

    Departs from the release in the straight-through estimator, taken once over the sum (theirs, once per layer,
    multiplies the encoder's gradient by the number of layers).
    """

    def __init__(self, *, codes: int, width: int, layers: int, **learning: Any) -> None:
        """`learning`: further arguments of `LearningCodebook`."""
        super().__init__(codes=codes, width=width, layers=0)
        self.layers.extend(LearningCodebook(codes=codes, width=width, **learning) for _ in range(layers))

    def books(self) -> Sequence[LearningCodebook]:
        """The codebooks, coarse to fine."""
        return [layer for layer in self.layers if isinstance(layer, LearningCodebook)]

    def forward(
        self,
        latents: Float[Tensor, "b n c"],
        *,
        temperature: float = 0.0,
        dropout: float = 0.0,
        generator: torch.Generator | None = None,
        share: Share | None = None,
    ) -> Quantized:
        """Quantise for training. The codebooks must have been initialised.

        Args:
            latents: what to quantise.
            temperature: > 0 draws codes in train mode by Gumbel noise on -distance^2 / temperature (release: 0.5).
            dropout: probability that this batch uses only a random number of leading layers (release: 0.2).
            generator: source of all randomness; None: the global one.
            share: these are some rows of a batch; the codebooks learn when `settle` is called after its last. None: the
                codebooks do not learn from them.
        """
        temperature = temperature if self.training else 0.0
        if share is not None:
            share = Share(share.first * latents.shape[1], share.of * latents.shape[1])
        with torch.autocast(latents.device.type, enabled=False):
            flat = latents.to(self.books()[0].codebook.dtype).flatten(0, 1)
            used = self._layers_used(dropout, generator)
            residual = flat
            losses: list[Tensor] = []
            chosen: list[Tensor] = []
            for q, book in enumerate(self.books()):
                if q >= used:
                    chosen.append(torch.full_like(chosen[0], -1))
                    continue
                target = residual.detach()
                codes = book.nearest(target, temperature=temperature, generator=generator, share=share)
                if share is not None:
                    book.keep(target, codes)
                vectors = book.lookup(codes)
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
        """Initialise all codebooks from many latents, layer by layer on the remainder."""
        residual = latents.to(self.books()[0].codebook.dtype)
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

    def _layers_used(self, dropout: float, generator: torch.Generator | None) -> int:
        if not self.training or dropout <= 0:
            return len(self.layers)
        chance, place = torch.rand(2, generator=generator, device=generator.device if generator else None).tolist()
        return 1 + int(place * len(self.layers)) if chance < dropout else len(self.layers)


@torch.no_grad()
def steady_codes(
    tokenizer: BodyTokenizer, features: Float[Tensor, "b t c"], patience: float = 0.0
) -> Int[Tensor, "b n p q"]:
    """`BodyTokenizer.encode`, or with `patience` the steadiest good codes of whole clips.

    A change of code then costs `patience` times the layer's mean error with the nearest codes.
    """
    if not patience:
        return tokenizer.encode(features)
    parts = zip(tokenizer.tokenizers().values(), tokenizer.latents(features), strict=True)
    return torch.stack([_steady_layers(part.quantizer, latents, patience) for part, latents in parts], 2)


def _steady_layers(
    quantizer: ResidualVectorQuantizer, latents: Float[Tensor, "b n c"], patience: float
) -> Int[Tensor, "b n q"]:
    chosen, residual = [], latents
    for book in quantizer.books():
        distances = book.squared_distances(residual.flatten(0, 1)).view(*latents.shape[:2], -1)
        prices = patience * distances.min(-1).values.mean(1)
        codes = torch.stack([steadiest(*clip) for clip in zip(distances, prices, strict=True)])
        residual = residual - book.lookup(codes)
        chosen.append(codes)
    return torch.stack(chosen, -1)
