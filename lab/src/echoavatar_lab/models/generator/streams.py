"""Stage 1 of the curriculum: embeddings learn to predict the next code of sound alone, and of motion alone.

Paper, Audio Driven Motion Generation (1) Embedding Space Alignment, after MECo: the new rows of the vocabulary find
their place in the body's latent space before the body is asked to relate them. The body is frozen; the rows of codes at
the input and at the output learn, and in the depth order everything but the backbone, because it is as new as they are.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from echoavatar.models.generator.model import Generator

from .windows import Window


class StreamNll(NamedTuple):
    """Negative log-likelihoods in nats, each under the codes that its position may hold."""

    audio: Float[Tensor, "b f l"]
    motion: Float[Tensor, "b k n"]


def stream_nll(generator: Generator, window: Window) -> StreamNll:
    """Sound and motion as separate streams; neither sees the other."""
    layout = generator.config.layout
    sound, moves = layout.audio_ids(window.audio), layout.motion_ids(window.motion)
    if generator.depth is None:
        hidden, moved = (generator(_shifted(ids, layout.start_id)) for ids in (sound, moves))
    else:
        hidden, moved = generator.depth.apart(generator.model, sound, moves)
    head = generator.lm_head.weight[layout.audio_base :][: layout.audio_layers * layout.audio_codes]
    logits = torch.einsum(
        "bflc,lac->bfla",
        hidden.unflatten(1, (-1, layout.audio_layers)),
        head.to(hidden.dtype).view(layout.audio_layers, layout.audio_codes, -1),
    )
    audio = _nll(logits, window.audio)
    at = torch.arange(moves.shape[1], device=moves.device).view(-1, layout.segments).T
    logits = generator.segment_logits(moved, at)
    motion = _nll(logits, window.motion.flatten(2).permute(2, 0, 1)).transpose(0, 1)
    return StreamNll(audio, motion)


def stream_loss(nll: StreamNll, depth_weights: Sequence[float]) -> Float[Tensor, ""]:
    """Both streams alike; motion weighted by RVQ depth as everywhere."""
    weights = torch.tensor(depth_weights, device=nll.motion.device)
    weights = weights.repeat(nll.motion.shape[1] // len(weights))[:, None]
    motion = (nll.motion * weights).mean() / weights.mean()
    return 0.5 * (nll.audio.mean() + motion)


def freeze_body(generator: Generator) -> None:
    """Train only the embeddings of codes at the input and at the output, and what the depth order adds."""
    generator.requires_grad_(False)
    learned: tuple[nn.Module | None, ...] = (generator.model.embed_tokens, generator.lm_head, generator.depth)
    for module in learned:
        if module is not None:
            module.requires_grad_(True)


def _shifted(ids: Int[Tensor, "b t"], start: int) -> Int[Tensor, "b t"]:
    return torch.cat([torch.full_like(ids[:, :1], start), ids[:, :-1]], dim=1)


def _nll(logits: Float[Tensor, "*n K"], codes: Int[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    flat = F.cross_entropy(logits.float().flatten(0, -2), codes.long().flatten(), reduction="none")
    return flat.view(codes.shape)
