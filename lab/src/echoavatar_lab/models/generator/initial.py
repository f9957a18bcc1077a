"""Initial weights of a generator: Qwen2.5's body, and embeddings made from the codebooks.

Paper, Audio Driven Motion Generation, stage 1 (Embedding Space Alignment): audio and motion codes are projected
into the model's latent space. `align_embeddings` does it without training: one fixed random orthogonal map per modality
keeps the distances between code vectors. Departs from the paper, which trains the embeddings with a frozen backbone.
"""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.errors import CheckpointError, DependencyError
from echoavatar.models.generator.model import Generator


def init_from_qwen(generator: Generator, folder: Path) -> None:
    """Copy the body of a local Qwen2 checkpoint; embeddings and head keep their new, detached rows.

    Where the vocabulary begins with Qwen's text rows (the reference layout) these are copied too.

    Raises:
        CheckpointError: the folder is missing or holds a model of another shape.
    """
    if not (folder / "config.json").exists():
        raise CheckpointError(
            f"{folder} holds no Qwen2 checkpoint; download Qwen/Qwen2.5-0.5B-Instruct and pass its folder"
        )
    try:
        from transformers import Qwen2ForCausalLM
    except ImportError as error:
        raise DependencyError(
            "reading Qwen2 weights needs transformers: pip install 'echoavatar-lab[pretrained]'"
        ) from error
    source = Qwen2ForCausalLM.from_pretrained(folder, local_files_only=True, dtype=torch.float32)
    weights, own = source.state_dict(), generator.state_dict()
    body = {key: value for key, value in weights.items() if key in own and _is_body(key)}
    wrong = [key for key in own if _is_body(key) and (key not in body or body[key].shape != own[key].shape)]
    if wrong:
        raise CheckpointError(f"{folder} does not fit this generator: {wrong[0]} and {len(wrong) - 1} more differ")
    generator.load_state_dict(body, strict=False)
    text = generator.config.layout.audio_base
    with torch.no_grad():
        if text > 1000:  # the vocabulary begins with Qwen's text rows
            rows = min(text, weights["model.embed_tokens.weight"].shape[0])
            generator.model.embed_tokens.weight[:rows] = weights["model.embed_tokens.weight"][:rows]
            if generator.depth is None:  # whose heads are as wide as the body
                generator.lm_head.weight[:rows] = weights["lm_head.weight"][:rows]


def _is_body(key: str) -> bool:
    return key.startswith("model.") and not key.startswith("model.embed_tokens")


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
