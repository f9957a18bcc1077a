"""Codes as ids of the vocabulary, and the paper's prompt; `echoavatar.models.tokens` has the layout and the orders."""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from echoavatar.models.tokens import Prefix, TokenLayout


def audio_ids(layout: TokenLayout, codes: Int[Tensor, "b f l"]) -> Int[Tensor, "b t"]:
    """Flatten audio codes (b, f, layers) into ids (b, f x layers): per frame layer 0, then layer 1."""
    layer = torch.arange(layout.audio_layers, device=codes.device) * layout.audio_codes + layout.audio_base
    return (codes.long() + layer).flatten(1)


def unflatten(layout: TokenLayout, flat: Int[Tensor, "b t"]) -> Int[Tensor, "b n p q"]:
    """Codes (b, n x 3 Q) in grammar order (codes, not ids) to motion codes (b, n, 3, Q)."""
    return flat.reshape(len(flat), -1, layout.parts, layout.motion_layers)


def motion_ids(layout: TokenLayout, codes: Int[Tensor, "b n p q"]) -> Int[Tensor, "b t"]:
    """Flatten motion codes into ids (b, n x 3 Q), segment by segment."""
    rows = torch.arange(layout.segments, device=codes.device) * layout.motion_codes + layout.motion_base
    return (codes.long().flatten(2) + rows).flatten(1)


def present(missing: Int[Tensor, " b"], chunks: int, each: int) -> Bool[Tensor, "b t"]:
    """False in the `missing` leading chunks of each row, of `chunks` chunks with `each` positions."""
    chunk = torch.arange(chunks, device=missing.device).repeat_interleave(each)
    return chunk >= missing[:, None]


def prefix_prompt(
    order: Prefix,
    audio: Int[Tensor, "b f l"],
    context: Int[Tensor, "b n p q"],
    missing: Int[Tensor, " b"],
    example: Int[Tensor, "b m"] | None = None,
) -> tuple[Int[Tensor, "b t"], Bool[Tensor, "b t"]]:
    """Ids and validity of audio followed by as much motion as `context` holds.

    `example` are the ids that a system prompt shows in front, -1 where a row has fewer (paper, Exemplar-Driven
    Control); rows without any have no system prompt.
    """
    rows, device, layout = audio.shape[0], audio.device, order.layout
    sound, moves = audio_ids(layout, audio), motion_ids(layout, context)
    before, between = (
        torch.tensor(ids, dtype=torch.int64, device=device).expand(rows, -1)
        for ids in (layout.before_audio, layout.before_motion)
    )
    chunks = sound.shape[1] // order.audio_per_chunk
    there = present(missing, chunks, order.audio_per_chunk)
    moved = present(missing, chunks, order.motion_per_chunk)[:, : moves.shape[1]]
    yes, also = torch.ones_like(before, dtype=torch.bool), torch.ones_like(between, dtype=torch.bool)
    ids, valid = [before, sound, between, moves], [yes, there, also, moved]
    if example is not None:
        shown, is_shown = _shown(layout, example)
        ids, valid = [shown, *ids], [is_shown, *valid]
    return torch.cat(ids, dim=1), torch.cat(valid, dim=1)


def _shown(layout: TokenLayout, example: Int[Tensor, "b m"]) -> tuple[Int[Tensor, "b t"], Bool[Tensor, "b t"]]:
    """The system prompt of each row; it is invalid in rows without an example."""
    rows, is_id = len(example), example >= 0
    head, tail = (
        torch.tensor(ids, dtype=torch.int64, device=example.device).expand(rows, -1)
        for ids in (layout.before_example, layout.after_example)
    )
    any_ = is_id.any(1, keepdim=True)
    valid = torch.cat([any_.expand(-1, head.shape[1]), is_id, any_.expand(-1, tail.shape[1])], dim=1)
    return torch.cat([head, example.clamp(min=0), tail], dim=1), valid
