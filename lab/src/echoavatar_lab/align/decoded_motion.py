"""Continuations decoded to motion, together with their audio events: the input of reward functions.

Rewards judge the motion that a viewer sees, so the pipeline's smoother runs behind the decoder: here over whole
motions, in torch, on a GPU or not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, Integer
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from echoavatar.motion.kinematics import Skeleton
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.stages.smoother import DELAY, FASTEST, SHOWN, STIFFNESS, shares
from echoavatar.timing import (
    AUDIO_FRAMES_PER_CHUNK,
    CHUNK_FRAMES,
    FRAME_RATE_HZ,
    FRAMES_PER_MOTION_TOKEN,
    MOTION_TOKENS_PER_CHUNK,
)
from echoavatar_lab.kinematics import forward_kinematics, from_features, matrix_from_quaternion, quaternion_from_matrix
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from .prompts import Prompt

LEAD_TOKENS = 2  # tokens of past motion that are kept, so that speeds are known at the first new frame
TOGETHER = 24  # prompts whose true motion is decoded at once
WARM_TOKENS = 8  # tokens decoded before those and discarded: the decoder's receptive field


@dataclass(frozen=True)
class DecodedMotion:
    """Motion at 30 fps that starts with `lead` frames of the past; times in seconds from the first new frame."""

    skeleton: Skeleton
    features: Float[np.ndarray, "t c"]
    positions: Float[np.ndarray, "t j 3"]  # metres, Y up
    lead: int
    domain: Integer[np.ndarray, " t"]  # 0 silence, 1 speech, 2 music
    beats: Float[np.ndarray, " m"]
    stresses: Float[np.ndarray, " k"]
    audio_codes: Int[np.ndarray, "f l"]  # codec tokens of the new frames; `motion_codes` likewise
    motion_codes: Int[np.ndarray, "n p q"]

    @property
    def frames(self) -> int:
        """New frames, without the lead."""
        return len(self.positions) - self.lead

    @cached_property
    def local(self) -> Float[np.ndarray, "t j 3"]:
        """Positions relative to the hips, smoothed over one frame to suppress noise."""
        relative = self.positions - self.positions[:, :1]
        return np.asarray(gaussian_filter1d(relative, 1.0, axis=0, mode="nearest"))

    def speed(self, joints: Sequence[int] | None = None) -> Float[np.ndarray, " t"]:
        """Mean speed (m/s) relative to the hips of some joints (default: all), on arriving at each new frame."""
        chosen = self.local if joints is None else self.local[:, list(joints)]
        steps = np.linalg.norm(np.diff(chosen, axis=0), axis=-1).mean(1) * FRAME_RATE_HZ
        return np.asarray(steps[self.lead - 1 :] if self.lead else np.concatenate([steps[:1], steps]))


@torch.no_grad()
def decode_continuations(
    tokenizer: BodyTokenizer, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"]
) -> list[DecodedMotion]:
    """Decode continuations; the rows of one prompt follow each other, the same number for each."""
    group = len(codes) // len(prompts)
    past = torch.from_numpy(np.stack([prompt.past for prompt in prompts]).astype(np.int64))
    decoded = decode_behind(tokenizer, past.to(codes.device).repeat_interleave(group, 0), codes)
    features, positions = (part.cpu().numpy() for part in decoded)
    lead = positions.shape[1] - codes.shape[1] * FRAMES_PER_MOTION_TOKEN
    first = past.shape[1] // MOTION_TOKENS_PER_CHUNK * AUDIO_FRAMES_PER_CHUNK
    motions = []
    for row in range(len(codes)):
        prompt = prompts[row // group]
        domain = np.repeat(prompt.domain, FRAMES_PER_MOTION_TOKEN)
        motions.append(
            DecodedMotion(
                tokenizer.skeleton,
                features[row],
                positions[row],
                lead,
                np.concatenate([np.full(lead, domain[0]), domain]),
                prompt.beats,
                prompt.stresses,
                prompt.audio[first:].astype(np.int64),
                codes[row].cpu().numpy(),
            )
        )
    return motions


def decode_truth(tokenizer: BodyTokenizer, prompts: Sequence[Prompt]) -> list[DecodedMotion]:
    """The clips' own continuations, decoded from their codes."""
    motions = []
    for start in range(0, len(prompts), TOGETHER):
        some = prompts[start : start + TOGETHER]
        truth = np.stack([prompt.truth for prompt in some]).astype(np.int64)
        motions += decode_continuations(tokenizer, some, torch.from_numpy(truth))
    return motions


def decode_behind(
    tokenizer: BodyTokenizer, past: Int[Tensor, "r m p q"], codes: Int[Tensor, "r n p q"]
) -> tuple[Float[Tensor, "r t c"], Float[Tensor, "r t j 3"]]:
    """Features and positions (m) of the continuations and of the last `LEAD_TOKENS` of their past.

    Both are on the tokenizer's device.
    """
    context = past[:, -(WARM_TOKENS + LEAD_TOKENS) :]
    features = tokenizer.decode(torch.cat([context, codes], 1).to(tokenizer.mean.device)).float()
    kept = slice(max(0, context.shape[1] - LEAD_TOKENS) * FRAMES_PER_MOTION_TOKEN, None)
    return features[:, kept], shown_positions(tokenizer.skeleton, features)[:, kept]


def shown_positions(skeleton: Skeleton, features: Float[Tensor, "r t c"]) -> Float[Tensor, "r t j 3"]:
    """Joint positions (metres, Y up) of decoded features behind the smoother; t is a multiple of a chunk's 8 frames."""
    travel = features[..., travel_slice(skeleton)][..., [0, 2, 1]]  # velocity across, height, velocity along
    rotations = quaternion_from_matrix(from_features(skeleton, features).rotations)
    rotations, root = _smoothed(rotations, travel)
    root[..., ::2] = root[..., ::2].cumsum(1)
    return forward_kinematics(skeleton, matrix_from_quaternion(rotations), root).positions


def _smoothed(
    rotations: Float[Tensor, "r t j 4"], root: Float[Tensor, "r t 3"]
) -> tuple[Float[Tensor, "r t j 4"], Float[Tensor, "r t 3"]]:
    """`motion.stages.smoother` over whole motions, chunk by chunk; before its first frame a body is at rest in it."""
    weights = torch.as_tensor(shares(CHUNK_FRAMES, STIFFNESS), dtype=rotations.dtype, device=rotations.device)
    shown, travelled = rotations[:, :1].expand(-1, SHOWN, -1, -1), root[:, :1].expand(-1, SHOWN, -1)
    rotations, root = (torch.cat([part[:, :1].repeat_interleave(DELAY, 1), part], 1) for part in (rotations, root))
    turned, moved = [], []
    for start in range(0, rotations.shape[1] - DELAY, CHUNK_FRAMES):
        at = slice(start, start + DELAY + CHUNK_FRAMES)
        path = _same_hemisphere(torch.cat([shown, rotations[:, at]], 1))
        wanted = F.normalize(torch.einsum("fn,rnjc->rfjc", weights, path), dim=-1)
        last, now = path[:, SHOWN - 1], []
        for frame in range(CHUNK_FRAMES):
            last = _slowed_down(last, wanted[:, frame])
            now.append(last)
        turned.append(torch.stack(now, 1))
        moved.append(torch.einsum("fn,rnc->rfc", weights, torch.cat([travelled, root[:, at]], 1)))
        shown, travelled = turned[-1][:, -SHOWN:], moved[-1][:, -SHOWN:]
    return torch.cat(turned, 1), torch.cat(moved, 1)


def _same_hemisphere(path: Float[Tensor, "r t j 4"]) -> Float[Tensor, "r t j 4"]:
    """The same rotations with signs such that each quaternion is in the hemisphere of the one before it."""
    signs = torch.where((path[:, 1:] * path[:, :-1]).sum(-1) < 0, -1.0, 1.0).cumprod(1)
    return torch.cat([path[:, :1], path[:, 1:] * signs[..., None]], 1)


def _slowed_down(before: Float[Tensor, "r j 4"], after: Float[Tensor, "r j 4"]) -> Float[Tensor, "r j 4"]:
    """`after`, or as far towards it as the fastest joint turns in a frame."""
    cosine = math.cos(FASTEST / FRAME_RATE_HZ / 2)
    along = (before * after).sum(-1, keepdim=True)
    after, along = torch.where(along < 0, -after, after), along.abs()
    aside = F.normalize(after - before * along, dim=-1)
    limit = F.normalize(before * cosine + aside * math.sqrt(1 - cosine * cosine), dim=-1)
    return torch.where(along >= cosine, after, limit)
