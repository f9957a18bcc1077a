"""The losses of a generator, and a measure of how much it relies on the sound.

The objective is the cross-entropy of motion codes, weighted by RVQ depth (paper, Hierarchical Loss Scaling).

Stage 1 of the curriculum (`stream_nll`; paper, Audio Driven Motion Generation (1) Embedding Space Alignment, after
MECo): embeddings learn to predict the next code of sound alone, and of motion alone, so that the new rows of the
vocabulary find their place in the body's latent space before the body is asked to relate them. The body is frozen; the
rows of codes at the input and at the output learn, and in the depth order everything but the backbone, because it is as
new as they are.

An auxiliary task (`CueReader`; not in the paper): the middle layer predicts beats and stressed syllables. Motion codes
are well predicted by the codes before them, so a small model hardly learns from them when a stroke is due. Trained on
the events themselves it learns them within a few hundred steps. The layer matters: no other position can read the
output of the last one. So the middle layer predicts, at each audio frame, whether a cue is on; one layer later, each
motion token's first position predicts which frames of its chunk hold cues, which the layers above it need to place a
stroke. In the depth order both are the same position, which hears ten audio frames and predicts their cues.

Reliance on the audio (`nll_by_domain`) is the likelihood of the true motion with the true audio and with another
clip's. It measures the paper's conditional collapse (Hierarchical Token Corruption) directly: the likelihood under a
collapsed model does not change with the audio.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from echoavatar.models.generator.config import AUDIO_FRAMES_PER_TOKEN
from echoavatar.models.tokens import UPPER
from echoavatar.timing import AUDIO_FRAMES_PER_CHUNK, MOTION_TOKENS_PER_CHUNK
from echoavatar_lab.data import DOMAINS
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokens import audio_ids, motion_ids
from echoavatar_lab.training.task import take_rows

from .sequences import Exemplar, Sequences, build_sequences, code_logits, heard_at, read, segment_logits, streams_apart
from .windows import CUES, TokenClip, Window, WindowSampler


def code_nll(
    generator: Generator,
    batch: Sequences,
    hidden: Float[Tensor, "b t c"] | None = None,
    exemplar: Exemplar | None = None,
    manner: Float[Tensor, "b t m"] | None = None,
) -> Float[Tensor, "b k n"]:
    """Negative log-likelihood in nats of every motion code under its segment's K logits.

    `hidden` are the generator's hidden states, where they are known already; `exemplar` is the directive, `manner` what
    is told of the speaker.
    """
    if hidden is None:
        hidden = read(generator, batch, exemplar, manner)
    logits = code_logits(generator, batch, hidden, exemplar, manner)
    return _nll(logits, batch.targets.transpose(0, 1)).transpose(0, 1)


def hierarchical_loss(
    nll: Float[Tensor, "b k n"], batch: Sequences, depth_weights: Sequence[float]
) -> Float[Tensor, ""]:
    """Mean over codes, each layer weighted by `depth_weights` (one per RVQ layer, the first is the coarsest)."""
    rows, segments, steps = nll.shape
    counted = (nll * batch.mask[:, None]).view(rows, -1, len(depth_weights), steps)
    by_layer = counted.sum((0, 1, 3)) / (batch.mask.sum() * (segments // len(depth_weights)))
    weighted = [weight * nats for weight, nats in zip(depth_weights, by_layer, strict=True)]
    return torch.stack(weighted).sum() / sum(depth_weights)


def summary(
    nll: Float[Tensor, "b k n"], batch: Sequences, window: Window, exemplar: Exemplar | None = None
) -> dict[str, Tensor]:
    """Mean NLL per domain, and per RVQ layer; of the directive's layer where one holds and where none does.

    A mean of nothing is NaN: asking whether there is something would wait for the device.
    """
    counts = batch.mask[:, None].expand_as(nll)
    heard = window.domain if batch.asked is None else window.domain[:, batch.asked]
    domain = heard.to(nll.device)[:, None].expand_as(nll)
    means = {f"nll_{name}": _mean(nll, counts & (domain == index)) for index, name in enumerate(DOMAINS)}
    parts = window.motion.shape[2]
    layers = nll.view(len(nll), parts, -1, nll.shape[2]).transpose(1, 2)
    there = counts.reshape(len(nll), parts, -1, nll.shape[2]).transpose(1, 2)
    if exemplar is not None:
        holds = exemplar.at(batch.asked).holds
        for name, where in (("told", holds), ("untold", ~holds)):
            means[f"nll_upper_{name}"] = _mean(layers[:, 0, UPPER], where & batch.mask)
    return means | {f"nll_layer_{q}": _mean(layers[:, q], there[:, q]) for q in range(layers.shape[1])}


def _mean(nll: Float[Tensor, "*any"], where: Bool[Tensor, "*any"]) -> Float[Tensor, ""]:
    return (nll * where).sum() / where.sum()


class StreamNll(NamedTuple):
    """Negative log-likelihoods in nats, each under the codes that its position may hold."""

    audio: Float[Tensor, "b f l"]
    motion: Float[Tensor, "b k n"]


def stream_nll(generator: Generator, window: Window) -> StreamNll:
    """Sound and motion as separate streams; neither sees the other."""
    layout = generator.config.layout
    sound, moves = audio_ids(layout, window.audio), motion_ids(layout, window.motion)
    hidden, moved = streams_apart(generator, sound, moves)
    head = generator.lm_head.weight[layout.audio_base :][: layout.audio_layers * layout.audio_codes]
    logits = torch.einsum(
        "bflc,lac->bfla",
        hidden.reshape(len(hidden), -1, layout.audio_layers, hidden.shape[2]),
        head.to(hidden.dtype).view(layout.audio_layers, layout.audio_codes, -1),
    )
    audio = _nll(logits, window.audio)
    at = torch.arange(moves.shape[1], device=moves.device).view(-1, layout.segments).T
    logits = segment_logits(generator, moved, at)
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


def _nll(logits: Float[Tensor, "*n K"], codes: Int[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    flat = F.cross_entropy(logits.float().flatten(0, -2), codes.long().flatten(), reduction="none")
    return flat.view(codes.shape)


ON_WEIGHT = 16.0  # cues are on for about one frame in thirty


class CueReader(nn.Module):
    """Two linear readouts (depth order: one) of a generator's hidden states while it trains.

    The generator itself stays as it is.
    """

    def __init__(self, generator: Generator) -> None:
        super().__init__()
        width = generator.config.width
        self._frames = 1 if generator.depth is None else AUDIO_FRAMES_PER_TOKEN  # that a position hears
        self.now = nn.Linear(width, self._frames * len(CUES))
        self.when = nn.Linear(width, AUDIO_FRAMES_PER_CHUNK * len(CUES)) if generator.depth is None else None
        self._order = generator.config.order
        self._states: dict[str, Tensor] = {}
        layers = generator.model.layers
        layers[(len(layers) - 1) // 2].register_forward_hook(self._keep("now"))
        if self.when is not None:
            layers[len(layers) // 2].register_forward_hook(self._keep("when"))

    def _keep(self, name: str) -> Any:
        def hook(module: nn.Module, inputs: tuple[Any, ...], output: Tensor) -> None:
            if module.training:
                self._states[name] = F.rms_norm(output, output.shape[-1:])

        return hook

    def loss(self, cues: Int[Tensor, "b f 2"], predictors: Int[Tensor, "k n"]) -> Float[Tensor, ""]:
        """Mean of the readouts' cross-entropies on the states of the generator's last forward pass.

        `predictors` are those of the sequences: row 0 holds each motion token's first position.
        """
        rows, frames, kinds = cues.shape
        now = self._states.pop("now")
        cues = cues.to(now.device)
        if self.when is None:
            return cue_loss(self.now(now), cues.view(rows, -1, self._frames * kinds))
        when = self._states.pop("when")
        heard = heard_at(self._order, frames // AUDIO_FRAMES_PER_CHUNK).to(now.device)
        by_chunk = cues.view(rows, -1, AUDIO_FRAMES_PER_CHUNK * kinds)
        of_token = by_chunk.repeat_interleave(MOTION_TOKENS_PER_CHUNK, 1)
        return 0.5 * (cue_loss(self.now(now[:, heard]), cues) + cue_loss(self.when(when[:, predictors[0]]), of_token))


def cue_loss(logits: Float[Tensor, "*any"], cues: Int[Tensor, "*any"]) -> Float[Tensor, ""]:
    """Cross-entropy of cues on or off, the rare ones that are on weighted up."""
    weight = torch.full((), ON_WEIGHT, device=logits.device)
    return F.binary_cross_entropy_with_logits(logits.float(), cues.to(logits).float(), pos_weight=weight)


@torch.no_grad()
def nll_by_domain(
    generator: Generator,
    clips: Sequence[TokenClip],
    *,
    shuffled_audio: bool = False,
    chunks: int | None = None,
    batch: int = 8,
    most_windows: int | None = None,
) -> dict[str, float]:
    """Mean NLL per motion code in nats by domain ("silence", "speech", "music", "all").

    Windows of `chunks` chunks (default: the generator's window) are cut without overlap; `most_windows` of them, spread
    evenly, are scored. `shuffled_audio` gives every window the audio of another clip's window (of another window where
    there is one clip only). Raises MotionError if no clip is as long as a window.
    """
    order, device = generator.config.order, next(generator.parameters()).device
    clips = [clip.heard_ahead(generator.config.ahead_chunks) for clip in clips]
    windows, audio = _windows(clips, chunks or generator.config.window_chunks, shuffled_audio)
    count = len(audio)
    picked = torch.arange(count) if most_windows is None else torch.arange(0, count, -(-count // most_windows))
    total, number = torch.zeros(len(DOMAINS)).double(), torch.zeros(len(DOMAINS)).double()
    for at in torch.split(picked, batch):
        motion = windows.motion[at]
        missing = torch.zeros(len(motion), dtype=torch.int64)
        sequences = take_rows(build_sequences(order, audio[at], motion, motion, missing), slice(None), device)
        nll = code_nll(generator, sequences).mean(dim=1).double().cpu()
        for index in range(len(DOMAINS)):
            here = windows.domain[at] == index
            total[index] += nll[here].sum()
            number[index] += here.sum()
    means = {name: (total[i] / number[i]).item() for i, name in enumerate(DOMAINS) if number[i] > 0}
    return means | {"all": (total.sum() / number.sum()).item()}


def _windows(clips: Sequence[TokenClip], chunks: int, shuffled_audio: bool) -> tuple[Window, Int[Tensor, "b f l"]]:
    """All windows, and the audio for each.

    Windows lie in the order of the clips, so a shift by the most windows of one clip always reaches another clip.
    """
    sampler = WindowSampler(clips, chunks=chunks)
    windows = Window(*(torch.cat(parts) for parts in zip(*sampler.grid(64), strict=True)))
    count = len(windows.audio)
    shift = min(sampler.most_per_clip, count // 2) if shuffled_audio else 0
    return windows, windows.audio.roll(shift, dims=0)
