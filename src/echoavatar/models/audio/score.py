"""Scores of a codec: reconstruction error beside that of silence, and use of the codebooks.

May import the rest of the room, `quantize` and below.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from echoavatar.config import Config

from ..quantize import code_usage
from .codec import AudioCodec
from .level import LevelControl
from .mel import log_mel


class CodecScore(Config):
    """Means over all frames; `log_mel` is the mean absolute difference in nats."""

    seconds: float
    log_mel: float
    log_mel_silence: float
    mel_correlation: float
    si_sdr_db: float
    usage: tuple[float, ...]
    perplexity: tuple[float, ...]


@torch.no_grad()
def score_codec(codec: AudioCodec, recordings: Sequence[Float[np.ndarray, " _"]]) -> CodecScore:
    """Pass recordings through level control, encoder and decoder, each from a fresh state."""
    level = LevelControl()
    distances, correlations, ratios, codes = [], [], [], []
    for recording in recordings:
        heard = level(torch.from_numpy(recording)[None])
        found = codec.encode(heard)
        made = codec.decode(found)[:, : heard.shape[1]]
        wanted, ours = (log_mel(sound, fft=1024, hop=256, bands=80) for sound in (heard, made))
        nothing = log_mel(torch.zeros_like(heard), fft=1024, hop=256, bands=80)
        distances.append(torch.stack([(ours - wanted).abs().mean(), (nothing - wanted).abs().mean()]))
        correlations.append(_correlation(ours, wanted))
        ratios.append(_si_sdr_db(made, heard))
        codes.append(found[0])
    weights = torch.tensor([float(len(recording)) for recording in recordings])
    weights = weights / weights.sum()
    usage = code_usage(torch.cat(codes), codec.config.codes)
    distance = (torch.stack(distances) * weights[:, None]).sum(0)
    return CodecScore(
        seconds=round(sum(len(recording) for recording in recordings) / 24_000, 1),
        log_mel=_rounded(distance[0]),
        log_mel_silence=_rounded(distance[1]),
        mel_correlation=_rounded((torch.stack(correlations) * weights).sum()),
        si_sdr_db=_rounded((torch.stack(ratios) * weights).sum()),
        usage=tuple(_rounded(value) for value in usage.fraction),
        perplexity=tuple(_rounded(value) for value in usage.perplexity),
    )


def _rounded(value: Tensor) -> float:
    return round(float(value), 3)


def _correlation(ours: Float[Tensor, "b t m"], theirs: Float[Tensor, "b t m"]) -> Float[Tensor, ""]:
    ours, theirs = (part.double() - part.double().mean() for part in (ours, theirs))
    size = ours.square().sum().sqrt() * theirs.square().sum().sqrt()
    return ((ours * theirs).sum() / size.clamp_min(1e-12)).float()


def _si_sdr_db(made: Float[Tensor, "b s"], wanted: Float[Tensor, "b s"]) -> Float[Tensor, ""]:
    """Scale-invariant signal-to-distortion ratio; about -40 and lower for unrelated sounds."""
    made, wanted = made.double(), wanted.double()
    fitted = wanted * ((made * wanted).sum() / wanted.square().sum().clamp_min(1e-12))
    ratio = fitted.square().sum() / (made - fitted).square().sum().clamp_min(1e-12)
    return (10 * torch.log10(ratio.clamp_min(1e-12))).float()
