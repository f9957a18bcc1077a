"""Continuations decoded to motion, together with their audio events: the input of reward functions.

Rewards judge what a viewer sees, so the pipeline's smoother runs behind the decoder.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int, Integer
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Skeleton, forward_kinematics
from echoavatar.motion.kinematics.rotations import matrix_from_quaternion
from echoavatar.motion.stages.pose import Pose, Unpacking
from echoavatar.motion.stages.smoother import Smoother
from echoavatar.timing import (
    AUDIO_FRAMES_PER_CHUNK,
    CHUNK_FRAMES,
    FRAME_RATE_HZ,
    FRAMES_PER_MOTION_TOKEN,
    MOTION_TOKENS_PER_CHUNK,
)

from .prompts import Prompt

LEAD_TOKENS = 2  # tokens of past motion that are kept, so that speeds are known at the first new frame
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
    audio_codes: Int[np.ndarray, "f l"] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    """Codec tokens of the new frames; `motion_codes` likewise."""
    motion_codes: Int[np.ndarray, "n p q"] = field(default_factory=lambda: np.zeros((0, 3, 1), np.int64))

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
    context = past[:, -(WARM_TOKENS + LEAD_TOKENS) :].repeat_interleave(group, 0)
    lead_tokens = min(LEAD_TOKENS, context.shape[1])
    features = tokenizer.decode(torch.cat([context, codes.cpu()], 1).to(tokenizer.mean.device)).cpu()
    lead = lead_tokens * FRAMES_PER_MOTION_TOKEN
    kept = slice((context.shape[1] - lead_tokens) * FRAMES_PER_MOTION_TOKEN, None)
    positions, features = shown_positions(tokenizer.skeleton, features.numpy())[:, kept], features[:, kept]
    first = past.shape[1] // MOTION_TOKENS_PER_CHUNK * AUDIO_FRAMES_PER_CHUNK
    motions = []
    for row in range(len(codes)):
        prompt = prompts[row // group]
        domain = np.repeat(prompt.domain, FRAMES_PER_MOTION_TOKEN)
        motions.append(
            DecodedMotion(
                tokenizer.skeleton,
                features[row].numpy(),
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


def shown_positions(skeleton: Skeleton, features: Float[np.ndarray, "b t c"]) -> Float[np.ndarray, "b t j 3"]:
    """Joint positions (m) of decoded features behind the smoother, which takes a chunk of 8 frames at a time."""
    whole, _ = Unpacking(skeleton).pose_of(features, FRAME_RATE_HZ)
    smoother, everyone = Smoother(skeleton.joints), np.ones(len(features), bool)
    state = smoother.init_state(len(features))
    for start in range(0, whole.frames, CHUNK_FRAMES):
        at = slice(start, start + CHUNK_FRAMES)
        smoother.step(Pose(whole.rotations[:, at], whole.root[:, at], whole.fps), state, everyone)
    whole.root[..., ::2] = whole.root[..., ::2].cumsum(1)  # travel along the ground is a velocity until here
    rotations = matrix_from_quaternion(torch.from_numpy(whole.rotations))
    return np.asarray(forward_kinematics(skeleton, rotations, torch.from_numpy(whole.root)).positions.numpy())


def decode_truth(tokenizer: BodyTokenizer, prompts: Sequence[Prompt]) -> list[DecodedMotion]:
    """The clips' own continuations, decoded from their codes."""
    truth = np.stack([prompt.truth for prompt in prompts]).astype(np.int64)
    return decode_continuations(tokenizer, prompts, torch.from_numpy(truth))
