"""One codebook, learned by moving averages (paper, Motion Tokenizer: codes come from a codebook C_q).

The averages (sums, counts) are buffers and can be saved (`training_state`), so that training resumes exactly;
they are left out of the state dict, whose only key is `codebook`.

A batch that is trained in pieces, or by several processes, must update a codebook as one batch: noise is drawn for the
whole batch and cut (`Share`), and the updates of the pieces are kept (`keep`) until all have passed (`settle`).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn


class Share(NamedTuple):
    """The position of some vectors in their batch: from `first` on, out of `of`."""

    first: int
    of: int


class Codebook(nn.Module):
    """`codes` vectors of `width` channels, the nearest of which stands for an input vector.

    Departures from the released recipe: k-means steps after the first-batch initialisation, a lower
    threshold for dead codes (both off by default); a revived code starts with the count of a fresh one, so
    that it is not dropped again at once.
    """

    codebook: Tensor
    sums: Tensor
    counts: Tensor
    ready: Tensor

    def __init__(
        self, *, codes: int, width: int, decay: float = 0.99, dead_below: float = 1.0, kmeans_steps: int = 0
    ) -> None:
        super().__init__()
        self.codes = codes
        self.width = width
        self.decay = decay
        self.dead_below = dead_below
        self.kmeans_steps = kmeans_steps
        self.register_buffer("codebook", torch.zeros(codes, width))
        self.register_buffer("sums", torch.zeros(codes, width), persistent=False)
        self.register_buffer("counts", torch.zeros(codes), persistent=False)
        self.register_buffer("ready", torch.zeros((), dtype=torch.bool), persistent=False)
        self._kept: list[tuple[Tensor, Tensor]] = []
        self.register_load_state_dict_post_hook(_adopt_loaded)  # type: ignore[no-untyped-call]

    def squared_distances(self, vectors: Float[Tensor, "n c"]) -> Float[Tensor, "n k"]:
        """Squared Euclidean distance of each vector to each code."""
        book = self.codebook
        return vectors.square().sum(-1, keepdim=True) - 2 * vectors @ book.T + book.square().sum(-1)

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

    def lookup(self, codes: Int[Tensor, "*n"]) -> Float[Tensor, "*n c"]:
        """Vectors of the codes; a negative code (layer not sent) is the zero vector."""
        return F.embedding(codes.clamp_min(0), self.codebook) * (codes >= 0).unsqueeze(-1)

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

    def load_training_state(self, state: dict[str, Tensor]) -> None:
        """Take over `training_state`; call it after `load_state_dict`."""
        for name, value in self.training_state().items():
            value.copy_(state[name])

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
    assert isinstance(module, Codebook)
    module.sums.copy_(module.codebook)
    module.counts.fill_(1)
    module.ready.fill_(True)
