"""Initial embeddings of a generator, made from the codebooks.

Paper, Audio Driven Motion Generation, stage 1 (Embedding Space Alignment): audio and motion codes are projected
into the model's latent space. `align_embeddings` does it without training: one fixed random orthogonal map per modality
keeps the distances between code vectors. Departs from the paper, which trains the embeddings with a frozen backbone.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.models.generator.model import Generator


def align_embeddings(
    generator: Generator,
    *,
    audio_codebooks: Float[Tensor, "l A a"] | None = None,
    motion_codebooks: Float[Tensor, "p q K c"] | None = None,
    scale: float = 0.02,
    seed: int = 0,
) -> None:
    """Set the embeddings of codes to their code vectors, projected orthogonally and scaled to `scale` per channel.

    Each codebook is centred and brought to unit mean square first; a random vector per codebook tells the layers apart.
    """
    layout, random = generator.config.layout, torch.Generator().manual_seed(seed)
    groups: list[tuple[int, Tensor]] = []
    if audio_codebooks is not None:
        groups.append((layout.audio_base, audio_codebooks))
    if motion_codebooks is not None:
        groups.append((layout.motion_base, motion_codebooks.flatten(0, 1)))
    with torch.no_grad():
        for base, books in groups:
            for table in generator.tables():
                rows = _project(books.detach().float().cpu(), table.embedding_dim, random) * scale
                table.weight[base : base + rows.shape[0]] = rows.to(table.weight.device)


def _project(books: Float[Tensor, "k K c"], width: int, random: torch.Generator) -> Float[Tensor, "rows width"]:
    books = books - books.mean(dim=1, keepdim=True)
    books = books / books.square().mean(dim=(1, 2), keepdim=True).clamp(min=1e-12).sqrt()
    square = torch.randn(max(width, books.shape[2]), max(width, books.shape[2]), generator=random)
    basis = torch.linalg.qr(square).Q[: books.shape[2], :width]
    spread = books @ basis * (width / basis.square().sum()) ** 0.5
    name = torch.randn(books.shape[0], 1, width, generator=random)
    rows: Tensor = ((spread + name) / 2**0.5).flatten(0, 1)
    return rows
