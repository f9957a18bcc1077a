"""Joint positions of many continuations at once: tokenizer, the pipeline's smoother, forward kinematics, all in torch.

The same numbers as `align.decoded_motion`, which takes one motion after the other through compiled loops on a CPU.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import forward_kinematics, from_features
from echoavatar.motion.kinematics.features import travel_slice
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion, quaternion_from_matrix
from echoavatar.motion.stages.smoother import FASTEST, SHOWN, STIFFNESS, shares
from echoavatar.timing import CHUNK_FRAMES, FRAME_RATE_HZ, FRAMES_PER_MOTION_TOKEN
from echoavatar_lab.align.decoded_motion import LEAD_TOKENS, WARM_TOKENS

LEAD = LEAD_TOKENS * FRAMES_PER_MOTION_TOKEN
TOGETHER = 256  # continuations decoded at a time


@torch.no_grad()
def shown_positions(
    tokenizer: BodyTokenizer, past: Int[Tensor, "r m p q"], codes: Int[Tensor, "r n p q"]
) -> Float[Tensor, "r t j 3"]:
    """Positions (metres, Y up) of `LEAD` frames of the past and of the continuation."""
    warm = WARM_TOKENS * FRAMES_PER_MOTION_TOKEN
    parts = []
    for before, new in zip(
        *(torch.split(part, TOGETHER) for part in (past[:, -(WARM_TOKENS + LEAD_TOKENS) :], codes)), strict=True
    ):
        features = tokenizer.decode(torch.cat([before, new], 1)).float()
        frames = from_features(tokenizer.skeleton, features)
        travel = features[..., travel_slice(tokenizer.skeleton)]
        velocity = torch.stack([travel[..., 0], travel[..., 2], travel[..., 1]], -1)  # across, height, along
        rotations, root = _smoothed(quaternion_from_matrix(frames.rotations), velocity)
        root = torch.stack([root[..., 0].cumsum(1), root[..., 1], root[..., 2].cumsum(1)], -1)
        pose = forward_kinematics(tokenizer.skeleton, matrix_from_quaternion(rotations), root)
        parts.append(pose.positions[:, warm:])
    return torch.cat(parts)


def _smoothed(
    rotations: Float[Tensor, "r t j 4"], root: Float[Tensor, "r t 3"]
) -> tuple[Float[Tensor, "r t j 4"], Float[Tensor, "r t 3"]]:
    """`motion.stages.smoother` over whole motions, chunk by chunk; before its first frame a body is at rest in it."""
    weights = torch.as_tensor(shares(CHUNK_FRAMES, STIFFNESS), dtype=rotations.dtype, device=rotations.device)
    shown, travelled = rotations[:, :1].expand(-1, SHOWN, -1, -1), root[:, :1].expand(-1, SHOWN, -1)
    turned, moved = [], []
    for start in range(0, rotations.shape[1], CHUNK_FRAMES):
        at = slice(start, start + CHUNK_FRAMES)
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
