"""Reliance on the audio: likelihood of the true motion with the true audio and with another clip's.

The paper's conditional collapse (Hierarchical Token Corruption), measured directly: the likelihood under a
collapsed model does not change with the audio.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Int
from torch import Tensor

from echoavatar.models.generator.model import Generator

from .corruption import corrupt_hierarchically
from .loss import code_nll, to_device
from .windows import DOMAINS, TokenClip, Window, WindowSampler


@torch.no_grad()
def nll_by_domain(
    generator: Generator,
    clips: Sequence[TokenClip],
    *,
    shuffled_audio: bool = False,
    chunks: int | None = None,
    batch: int = 8,
    most_windows: int | None = None,
    corruption: float = 0.0,
) -> dict[str, float]:
    """Mean NLL per motion code in nats by domain ("silence", "speech", "music", "all").

    Windows of `chunks` chunks (default: the generator's window) are cut without overlap; `most_windows` of them, spread
    evenly, are scored. `shuffled_audio` gives every window the audio of another clip's window (of another window where
    there is one clip only). `corruption` damages the context hierarchically at that rate.

    Raises:
        MotionError: no clip is as long as a window.
    """
    order, device = generator.config.order, str(next(generator.parameters()).device)
    clips = [clip.heard_ahead(generator.config.ahead_chunks) for clip in clips]
    windows, audio = _windows(clips, chunks or generator.config.window_chunks, shuffled_audio)
    random = torch.Generator().manual_seed(0)
    count = len(audio)
    picked = torch.arange(count) if most_windows is None else torch.arange(0, count, -(-count // most_windows))
    total, number = torch.zeros(len(DOMAINS)).double(), torch.zeros(len(DOMAINS)).double()
    for at in torch.split(picked, batch):
        motion = context = windows.motion[at]
        if corruption > 0:
            codebook = generator.config.layout.motion_codes
            context = corrupt_hierarchically(motion, corruption, codebook=codebook, generator=random)
        missing = torch.zeros(len(motion), dtype=torch.int64)
        sequences = to_device(order.build(audio[at], context, motion, missing), device)
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
