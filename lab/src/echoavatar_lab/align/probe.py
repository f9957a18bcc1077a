"""Measures a policy on held-out prompts, with the same prompts and seeds every time.

From codes to rewards: motion is decoded, then the reward functions judge it. FID, diversity and beat alignment minus
chance, against the true motion of the prompts, show what a gain in reward costs. At each checkpoint some prompts become
videos; a reward that is gamed shows in them. Token files hold no waveform, so the codec's decoder makes the sound.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from echoavatar.files.avatar.video import Shot, write_film
from echoavatar.motion.kinematics import Skeleton
from echoavatar.whole_file import make_output_folder
from echoavatar_lab.evaluation.measures import latent_moments
from echoavatar_lab.evaluation.metrics.distributions import Moments, frechet_between, pooled
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder
from echoavatar_lab.evaluation.metrics.positions import l1_deviation
from echoavatar_lab.kinematics import from_features, quaternion_from_matrix
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.audio.decoding import decode
from echoavatar_lab.models.tokenize import motion_of_codes
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from .decoded_motion import DecodedMotion, decode_continuations, decode_truth
from .policy import GeneratorPolicy, exact_kl, mean_by_layer
from .prompts import Prompt, batch_of
from .rewards import ReferenceStatistics, RewardMix, Rewards, beat_alignment, stress_alignment

TOGETHER = 8  # prompts that are drawn, scored or decoded at once
Measurements = dict[str, object]


class MotionMetrics:
    """Measures motion made for the prompts that this object was built with."""

    def __init__(
        self,
        tokenizer: BodyTokenizer,
        prompts: Sequence[Prompt],
        extractor: MotionEncoder,
        reference_statistics: ReferenceStatistics,
    ) -> None:
        self.truth = decode_truth(tokenizer, prompts)
        self._extractor, self._reference_statistics = extractor, reference_statistics
        self._wanted = self._latents(self.truth)

    def __call__(self, motions: Sequence[DecodedMotion]) -> Measurements:
        """`fid`, `diversity` (m), `beat_alignment` and `stress_alignment`; the last two as mean and standard error."""
        aligned = {
            name: [float(np.sum(score(s, self._reference_statistics))) for s in motions if len(getattr(s, events))]
            for name, events, score in (
                ("beat_alignment", "beats", beat_alignment),
                ("stress_alignment", "stresses", stress_alignment),
            )
        }
        relative = [motion.positions - motion.positions[:, :1] for motion in motions]
        return {
            "fid": frechet_between(self._latents(motions), self._wanted),
            "diversity": float(np.mean([l1_deviation(one) for one in relative])),
            **{name: mean_and_error(np.array(values)) for name, values in aligned.items() if values},
        }

    def _latents(self, motions: Sequence[DecodedMotion]) -> Moments:
        features = torch.from_numpy(np.stack([motion.features for motion in motions]))
        return pooled(feature_moments(self._extractor, motions[0].skeleton, features))


def feature_moments(extractor: MotionEncoder, skeleton: Skeleton, features: Float[Tensor, "b t c"]) -> list[Moments]:
    """Moments of the extractor's latents of each decoded clip."""
    moved = from_features(skeleton, features)
    rotations = quaternion_from_matrix(moved.rotations)
    return [latent_moments(extractor, own, root) for own, root in zip(rotations, moved.root, strict=True)]


def mean_and_error(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Mean and standard error."""
    error = values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else 0.0
    return round(float(values.mean()), 5), round(float(error), 5)


PIECE = 64  # continuations decoded at a time
Judge = Callable[[Sequence[Prompt], Int[Tensor, "r n p q"]], Rewards]
"""Rewards of continuations; the rows of one prompt follow each other."""


class DecodingJudge:
    """Decodes continuations with the bundle's tokenizer and judges the motion."""

    def __init__(self, tokenizer: BodyTokenizer, mix: RewardMix) -> None:
        self.tokenizer, self.mix = tokenizer, mix

    def __call__(
        self, prompts: Sequence[Prompt], codes: Int[Tensor, "r n p q"], motions: list[DecodedMotion] | None = None
    ) -> Rewards:
        """Rewards of continuations; their motion is appended to `motions`."""
        group = len(codes) // len(prompts)
        each = max(1, PIECE // group)
        found = []
        for start in range(0, len(prompts), each):
            some = prompts[start : start + each]
            rows = codes[start * group : (start + len(some)) * group]
            made = decode_continuations(self.tokenizer.to(codes.device), some, rows)
            found.append(self.mix(made))
            if motions is not None:
                motions += made
        parts = {name: np.concatenate([one.parts[name] for one in found]) for name in found[0].parts}
        tokens, whole = (np.concatenate([getattr(one, field) for one in found]) for field in ("tokens", "whole"))
        return Rewards(tokens, whole, parts)


SEED = 987_654_321  # different from any run's own seed


class Probe:
    """Rewards, divergence and entropy of a policy; with `motion_metrics` also FID, diversity and beat alignment."""

    def __init__(
        self,
        prompts: Sequence[Prompt],
        judge: Judge,
        *,
        group: int,
        motion_metrics: MotionMetrics | None = None,
        seed: int = SEED,
    ) -> None:
        """`motion_metrics` needs a judge that decodes motion (`DecodingJudge`)."""
        self.prompts, self._judge, self._group = list(prompts), judge, group
        self._motion_metrics, self._seed = motion_metrics, seed

    @torch.no_grad()
    def __call__(self, policy: GeneratorPolicy, reference: GeneratorPolicy) -> dict[str, object]:
        """Means with standard errors over prompts.

        `by_prompt` allows a paired comparison with an earlier measurement (`compare.gain`): prompts differ from each
        other far more than a tuned policy differs from the one it started as.
        """
        began, group = time.monotonic(), self._group
        random = torch.Generator().manual_seed(self._seed)
        seeds = torch.randint(2**62, (len(self.prompts), group), generator=random)
        device = str(next(policy.generator.parameters()).device)
        codes, kl, entropy = [], [], []
        for at in range(0, len(self.prompts), TOGETHER):
            batch = batch_of(self.prompts[at : at + TOGETHER], device)
            codes.append(policy.rollout(batch, group, seeds[at : at + TOGETHER].flatten().to(device)))
            every = batch.repeated(group)
            own = policy.score(every, codes[-1])
            other = reference.score(every, codes[-1], own.support)
            kl.append(exact_kl(own.all_log_probs, other.all_log_probs, own.support))
            entropy.append(own.entropy)
        rewards, cost = self._judged(torch.cat(codes))
        by_prompt = {
            name: values.reshape(-1, group).mean(1) for name, values in {"": rewards.total, **rewards.parts}.items()
        }
        return {
            "reward": mean_and_error(by_prompt[""]),
            "rewards": {name: mean_and_error(values) for name, values in by_prompt.items() if name},
            "by_prompt": [round(float(mean), 5) for mean in by_prompt[""]],
            "kl": float(torch.cat(kl).mean()),
            "entropy": mean_by_layer(torch.cat(entropy), policy.layout.motion_layers),
            **cost,
            "seconds": round(time.monotonic() - began, 2),
        }

    def _judged(self, codes: torch.Tensor) -> tuple[Rewards, Mapping[str, object]]:
        if self._motion_metrics is None:
            return self._judge(self.prompts, codes), {}
        assert isinstance(self._judge, DecodingJudge)
        motions: list[DecodedMotion] = []
        return self._judge(self.prompts, codes, motions), self._motion_metrics(motions)


FILM_SIZE = (480, 360)
FILM_SEED = 20


class SampleVideos:
    """Writes `FOLDER_0.mp4` and so on: the prompt's past, then the policy's continuation."""

    def __init__(self, codec: AudioCodec, tokenizer: BodyTokenizer, prompts: Sequence[Prompt]) -> None:
        self._codec, self._tokenizer, self._prompts = codec, tokenizer, list(prompts)

    @torch.no_grad()
    def __call__(self, policy: GeneratorPolicy, path: Path) -> None:
        """One file for each prompt, with the same seeds every time."""
        device = next(policy.generator.parameters()).device
        batch = batch_of(self._prompts, str(device))
        seeds = torch.arange(FILM_SEED, FILM_SEED + len(self._prompts), device=device)
        codes = torch.cat([batch.past, policy.rollout(batch, 1, seeds)], 1)
        sounds = decode(self._codec, batch.audio.cpu())
        make_output_folder(path.parent)
        for at, (row, sound) in enumerate(zip(codes, sounds, strict=True)):
            target = path.with_name(f"{path.name}_{at}.mp4")
            write_film(target, motion_of_codes(self._tokenizer, row), sound.numpy(), shot=Shot(FILM_SIZE, samples=1))
