"""Training sequences: windows of codes as ids, which position predicts which code, and what a generator says there.

Sequences are of whole chunks. `context` codes are read and `target` codes are asked for; they differ where the context
is corrupted. `missing` leading chunks of a row carry no loss, as at the beginning of a session; in the order `prefix`
they are not there at all.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from echoavatar.models.audio.codec_config import CODE_LAYERS
from echoavatar.models.tokens import PARTS, UPPER, Depth, Prefix, SequenceOrder, TokenLayout
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK, exact_div
from echoavatar_lab.models.generator.exemplar import member_rows
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokens import audio_ids, motion_ids, prefix_prompt, present


def compact_layout(
    *, audio_codes: int, motion_layers: int, motion_codes: int, parts: int = PARTS, has_example: bool = False
) -> TokenLayout:
    """The smallest vocabulary for these codebooks: four specials, audio rows, motion rows.

    With `has_example` a prefix prompt may show control tokens behind the fourth special; no row is added for it.
    """
    motion_base = 4 + CODE_LAYERS * audio_codes
    return TokenLayout(
        audio_layers=CODE_LAYERS,
        audio_codes=audio_codes,
        motion_layers=motion_layers,
        motion_codes=motion_codes,
        parts=parts,
        before_example=(3,) if has_example else (),
        motion_base=motion_base,
        vocabulary=motion_base + parts * motion_layers * motion_codes,
    )


class Exemplar(NamedTuple):
    """Directives of a batch of training windows."""

    members: Float[Tensor, "b K"]  # the intensity of each code of the set; 0 where not in it
    holds: Bool[Tensor, "b n"]  # motion time steps during which the directive is given

    def at(self, steps: Int[Tensor, " m"] | None) -> "Exemplar":
        """The same at these time steps alone; None is all."""
        return self if steps is None else self._replace(holds=self.holds[:, steps])


class Sequences(NamedTuple):
    """Training sequences: ids in, motion codes out. k = 3 Q segments, n motion time steps."""

    ids: Int[Tensor, "b t"]
    valid: Bool[Tensor, "b t"] | None  # None where every position counts
    predictors: Int[Tensor, "k n"]  # the position whose output predicts segment k of time step n
    targets: Int[Tensor, "b k n"]  # codes 0..K-1
    mask: Bool[Tensor, "b n"]  # time steps that carry loss
    asked: Int[Tensor, " n"] | None = None  # depth order: the time steps whose codes are asked for; None is all

    def asking(self, asked: Int[Tensor, " m"]) -> "Sequences":
        """The same ids, of which the codes of these time steps alone are asked for (depth order)."""
        predictors = self.predictors[:, : len(asked)]  # hidden states are counted among those asked
        return self._replace(
            predictors=predictors, targets=self.targets[:, :, asked], mask=self.mask[:, asked], asked=asked
        )


def build_sequences(
    order: SequenceOrder,
    audio: Int[Tensor, "b f l"],
    context: Int[Tensor, "b n p q"],
    target: Int[Tensor, "b n p q"],
    missing: Int[Tensor, " b"],
    example: Int[Tensor, "b m"] | None = None,
) -> Sequences:
    """Sequences in this order. `example` (order `prefix`): see `tokens.prefix_prompt`.

    In the depth order `predictors` count hidden states, which are one per code, frame after frame.
    """
    layout, (rows, steps), device = order.layout, context.shape[:2], audio.device
    chunks, valid = exact_div(steps, MOTION_TOKENS_PER_CHUNK), None
    if isinstance(order, Prefix):
        ids, valid = prefix_prompt(order, audio, context, missing, example)
        ids, valid = ids[:, :-1], valid[:, :-1]
        at = torch.arange(ids.shape[1] - steps * layout.segments, ids.shape[1], device=device)
    else:
        groups = steps if isinstance(order, Depth) else chunks
        sound, moves = (part.view(rows, groups, -1) for part in (audio_ids(layout, audio), motion_ids(layout, context)))
        ids = torch.cat([sound, moves], dim=2).flatten(1)
        at = torch.arange(steps * layout.segments, device=device)
        if not isinstance(order, Depth):
            ids = torch.cat([torch.full_like(ids[:, :1], layout.start_id), ids[:, :-1]], dim=1)
            at = at + (at // order.motion_per_chunk + 1) * order.audio_per_chunk
    predictors = at.view(-1, layout.segments).T.contiguous()
    mask = present(missing, chunks, MOTION_TOKENS_PER_CHUNK)
    return Sequences(ids, valid, predictors, target.long().flatten(2).transpose(1, 2), mask)


def heard_at(order: SequenceOrder, chunks: int) -> Int[Tensor, " f"]:
    """For each audio frame of `chunks` chunks the position whose input is its last code (not in the depth order)."""
    frames = torch.arange(chunks * AUDIO_FRAMES_PER_CHUNK)
    if isinstance(order, Prefix):
        return len(order.layout.before_audio) - 1 + (frames + 1) * order.layout.audio_layers
    chunk = frames // AUDIO_FRAMES_PER_CHUNK
    return chunk * order.motion_per_chunk + (frames + 1) * order.layout.audio_layers


def read(
    generator: Generator,
    batch: Sequences,
    exemplar: Exemplar | None = None,
    manner: Float[Tensor, "b t m"] | None = None,
) -> Float[Tensor, "b t c"]:
    """Hidden states of the sequences, under a directive and for a manner where these are given."""
    hints = None
    if exemplar is not None and generator.exemplar is not None:
        rows = member_rows(generator.model.embed_tokens.weight, generator.config.layout)
        hint = generator.exemplar.hint(exemplar.members, rows)
        there = exemplar.holds.to(hint)
        if generator.depth is None:  # at each position that predicts a code while the set holds
            there = torch.zeros(batch.ids.shape, dtype=hint.dtype, device=hint.device)
            for predictors in batch.predictors:
                there[:, predictors] = exemplar.holds.to(hint)
        hints = there[..., None] * hint[:, None]
    if manner is not None and generator.manner is not None:
        told = generator.manner.hint(manner)
        hints = told if hints is None else hints + told
    hidden: Tensor = generator(batch.ids, batch.valid, hints, batch.asked)
    return hidden


def segment_logits(
    generator: Generator, hidden: Float[Tensor, "b t c"], predictors: Int[Tensor, "k n"]
) -> Float[Tensor, "k b n K"]:
    """For each segment its K logits at the positions that predict it: one grouped product."""
    chosen = hidden[:, predictors].transpose(0, 1).flatten(1, 2)
    logits = torch.bmm(chosen, generator.segment_head().transpose(1, 2))
    return logits.view(len(logits), len(hidden), -1, generator.config.layout.motion_codes)


def code_logits(
    generator: Generator,
    batch: Sequences,
    hidden: Float[Tensor, "b t c"],
    exemplar: Exemplar | None = None,
    manner: Float[Tensor, "b t m"] | None = None,
) -> Float[Tensor, "k b n K"]:
    """Logits of every motion code asked for, raised by a directive's set where it holds and by the heights of hands."""
    logits = segment_logits(generator, hidden, batch.predictors)
    segment, raised = len(logits) // PARTS * UPPER, []
    upper = hidden[:, batch.predictors[segment]]
    if exemplar is not None and generator.exemplar is not None:
        gate = generator.exemplar.gate(upper) * exemplar.at(batch.asked).holds[..., None]
        raised.append(gate * exemplar.members[:, None])
    if manner is not None and generator.manner is not None:
        told = manner if batch.asked is None else manner[:, batch.asked]
        raised.append(generator.manner.gate(upper) * generator.manner.likely(told))
    if not raised:
        return logits
    told = logits[segment] + torch.stack(raised).sum(0).to(logits)
    return torch.cat([logits[:segment], told[None], logits[segment + 1 :]])


def streams_apart(
    generator: Generator, sound: Int[Tensor, "b t"], moves: Int[Tensor, "b m"]
) -> tuple[Float[Tensor, "b t d"], Float[Tensor, "b m d"]]:
    """The hidden states that predict each audio id from sound alone, and each motion id from motion alone."""
    start, depth = torch.full_like(sound[:, :1], generator.config.layout.start_id), generator.depth
    if depth is None:
        by_sound, by_motion = (generator(torch.cat([start, ids[:, :-1]], dim=1)) for ids in (sound, moves))
        return by_sound, by_motion
    backbone = generator.model
    sounds, codes = (ids.view(len(ids), -1, size) for ids, size in zip((sound, moves), depth.sizes, strict=True))
    heard = torch.cat([backbone.embed_tokens(start), depth.heard(backbone, sounds)[:, :-1]], dim=1)
    by_sound, by_motion = depth.run(backbone, heard), depth.run(backbone, depth.moved(backbone, codes))
    return depth.codes(by_sound, sounds), depth.codes(by_motion, codes)
