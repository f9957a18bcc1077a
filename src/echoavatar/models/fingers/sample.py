"""Hands for clips of any length: denoising in overlapping windows that are blended in every step.

All windows read the same noisy clip, and their outputs are averaged before the next step, so no seams appear.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from .model import FingerModel

STEPS = 8
_ROWS = 32  # windows in one call of the model
_LIMIT = 4.0  # standard deviations at which a coordinate is clamped


@torch.inference_mode()
def sample_hands(
    model: FingerModel,
    body: Float[Tensor, "t c"],
    known: Float[Tensor, "t 2 k"],
    is_known: Bool[Tensor, "t 2"],
    *,
    seed: int = 0,
    steps: int = STEPS,
    progress: Callable[[int, int], None] | None = None,
) -> Float[Tensor, "t 2 k"]:
    """Coordinates of both hands; known hands are returned unchanged.

    Args:
        model: a trained finger model.
        body: features of the clip (`body_features`), not normalised.
        known: coordinates of the kept hands; other entries are ignored.
        is_known: which hands are kept in each frame.
        seed: of the noise; another seed gives other hands.
        steps: of denoising; 1 gives the mean of all plausible hands, more steps give a sample.
        progress: called with (steps done, steps).
    """
    frames, count = model.config.frames, len(body)
    random = torch.Generator().manual_seed(seed)
    hands = torch.randn(known.shape, generator=random)
    index = _windows(count, frames, model.config.patch)
    weight = torch.sin((torch.arange(frames) + 0.5) / frames * torch.pi).square()
    normal = model.normalize_body(body)[index]
    kept, clean = is_known[..., None], hands
    for step in range(steps):
        level, after = 1 - step / steps, 1 - (step + 1) / steps
        seen = torch.where(kept, known, hands)
        clean = _blend(model, seen, is_known, level, normal, index, weight)
        noise = (hands - (1 - level) * clean) / level
        hands = (1 - after) * clean + after * noise
        if progress is not None:
            progress(step + 1, steps)
    return torch.where(kept, known, clean)


def _windows(count: int, frames: int, patch: int) -> Tensor:
    """Frames of each window (w, frames): about half overlapping; a short clip repeats its last frame.

    The stride is no multiple of a token, so token borders of neighbouring windows do not coincide.
    """
    stride = max(1, frames // 2 - patch // 2)
    starts = [*range(0, max(1, count - frames), stride), max(0, count - frames)]
    unique = torch.tensor(sorted(set(starts)))
    return (unique[:, None] + torch.arange(frames)).clamp(max=count - 1)


def _blend(
    model: FingerModel, hands: Tensor, is_known: Tensor, level: float, body: Tensor, index: Tensor, weight: Tensor
) -> Tensor:
    total, share = torch.zeros_like(hands), torch.zeros(len(hands))
    for first in range(0, len(index), _ROWS):
        at = index[first : first + _ROWS]
        levels = torch.full((len(at),), level)
        clean = model(hands[at], is_known[at], levels, body[first : first + _ROWS])
        total.index_add_(0, at.flatten(), (clean * weight[:, None, None]).flatten(0, 1))
        share.index_add_(0, at.flatten(), weight.repeat(len(at)))
    limit = _LIMIT * model.basis.spread
    mean = total / share[:, None, None]
    return torch.maximum(torch.minimum(mean, limit), -limit)
