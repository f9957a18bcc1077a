"""Renders what a policy does on held-out prompts at each checkpoint; a reward that is gamed shows in the video.

Token files hold no waveform, so the codec's decoder makes the sound.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from echoavatar.files.avatar.video import Shot, write_film
from echoavatar.models.audio import AudioCodec
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar.motion.kinematics import Motion, from_features
from echoavatar.motion.kinematics.rotations import quaternion_from_matrix
from echoavatar.timing import FRAME_RATE_HZ

from .policy import GeneratorPolicy
from .prompts import Prompt, batch_of

SIZE = (480, 360)
SEED = 20


class SampleVideos:
    """Writes `FOLDER_0.mp4` and so on: the prompt's past, then the policy's continuation."""

    def __init__(self, codec: AudioCodec, tokenizer: BodyTokenizer, prompts: Sequence[Prompt]) -> None:
        self._codec, self._tokenizer, self._prompts = codec, tokenizer, list(prompts)

    @torch.no_grad()
    def __call__(self, policy: GeneratorPolicy, path: Path) -> None:
        """One file for each prompt, with the same seeds every time."""
        device = next(policy.generator.parameters()).device
        batch = batch_of(self._prompts, str(device))
        seeds = torch.arange(SEED, SEED + len(self._prompts), device=device)
        codes = torch.cat([batch.past, policy.rollout(batch, 1, seeds)], 1).cpu()
        sounds = self._codec.decode(batch.audio.cpu())
        path.parent.mkdir(parents=True, exist_ok=True)
        for at, (row, sound) in enumerate(zip(codes, sounds, strict=True)):
            target = path.with_name(f"{path.name}_{at}.mp4")
            write_film(target, self._motion(row), sound.numpy(), shot=Shot(SIZE, samples=1))

    def _motion(self, codes: Tensor) -> Motion:
        moved = from_features(
            self._tokenizer.skeleton, self._tokenizer.decode(codes[None].to(self._tokenizer.mean.device)).cpu()
        )
        turns = quaternion_from_matrix(moved.rotations)[0].numpy()
        return Motion(self._tokenizer.skeleton, turns, moved.root[0].numpy(), FRAME_RATE_HZ)
