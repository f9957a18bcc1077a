"""What tuning gained and what it cost: generators side by side on the same held-out prompts, with the same seeds.

Rewards as means with standard errors over prompts, and as gains over the first generator, prompt by prompt; FID against
the true motion of these prompts, diversity, beat alignment less its chance, divergence from the first generator.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float

from ..generator import Generator
from ..kinematics import from_features
from ..kinematics.rotations import quaternion_from_matrix
from ..metrics.diversity import l1_deviation
from ..metrics.frechet import Moments, frechet_between, moments, pooled
from ..metrics.motion_encoder import MotionEncoder
from ..metrics.motion_features import motion_features
from ..tokenizer import BodyTokenizer
from .losses import exact_kl
from .policy import GeneratorPolicy, check_reference
from .prompts import Prompt, batch_of
from .rewards import RewardMix, beat_alignment, stress_alignment
from .scene import Scene, decode_scenes, true_scenes

TOGETHER = 8  # prompts whose continuations are drawn at once
Told = dict[str, object]


def compare(
    generators: Mapping[str, Generator],
    tokenizer: BodyTokenizer,
    prompts: Sequence[Prompt],
    mix: RewardMix,
    extractor: MotionEncoder,
    *,
    group: int = 4,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Told]:
    """Measurements of each generator by name, those of the true motion first.

    Raises:
        CheckpointError: generators speak different vocabularies.
    """
    first = next(iter(generators.values()))
    for name, generator in generators.items():
        check_reference(generator, first, name=name)
    true = [
        scene
        for at in range(0, len(prompts), TOGETHER)
        for scene in true_scenes(tokenizer, prompts[at : at + TOGETHER])
    ]
    wanted = _latents(true, extractor)
    told: dict[str, Told] = {"truth": _measured(true, mix, extractor, wanted, group=1)}
    base: Float[np.ndarray, " p"] | None = None
    for number, (name, generator) in enumerate(generators.items()):
        scenes, kl = _continued(generator, first, tokenizer, prompts, group, seed)
        found = _measured(scenes, mix, extractor, wanted, group=group)
        total = mix(scenes).total.reshape(-1, group).mean(1)
        base = total if base is None else base
        told[name] = found | {"gain": _mean_and_error(total - base), "kl": kl}
        if progress is not None:
            progress(number + 1, len(generators))
    return told


@torch.no_grad()
def _continued(
    generator: Generator,
    first: Generator,
    tokenizer: BodyTokenizer,
    prompts: Sequence[Prompt],
    group: int,
    seed: int,
) -> tuple[list[Scene], float]:
    """Continuations as scenes, and the divergence from the first generator in nats a code."""
    policy = GeneratorPolicy(generator.eval())
    reference = GeneratorPolicy(first.eval())
    random = torch.Generator().manual_seed(seed)
    seeds = torch.randint(2**62, (len(prompts), group), generator=random)
    scenes, kls = [], []
    for at in range(0, len(prompts), TOGETHER):
        some = prompts[at : at + TOGETHER]
        batch = batch_of(some)
        codes = policy.rollout(batch, group, seeds[at : at + len(some)].flatten())
        every = batch.repeated(group)
        own = policy.score(every, codes)
        other = reference.score(every, codes, own.support)
        kls.append(exact_kl(own.all_log_probs, other.all_log_probs, own.support).mean((1, 2)))
        scenes += decode_scenes(tokenizer, some, codes)
    return scenes, float(torch.cat(kls).mean())


def _measured(
    scenes: Sequence[Scene], mix: RewardMix, extractor: MotionEncoder, wanted: Moments, *, group: int
) -> Told:
    rewards, yardstick = mix(scenes), mix.yardstick
    assert yardstick is not None, "a comparison weighs rewards"
    aligned = {
        "beat_alignment": [beat_alignment(s, yardstick) for s in scenes if len(s.beats)],
        "stress_alignment": [stress_alignment(s, yardstick) for s in scenes if len(s.stresses)],
    }
    relative = [scene.positions - scene.positions[:, :1] for scene in scenes]
    return {
        "reward": _mean_and_error(rewards.total.reshape(-1, group).mean(1)),
        "rewards": {
            name: _mean_and_error(values.reshape(-1, group).mean(1)) for name, values in rewards.parts.items()
        },
        "fid": frechet_between(_latents(scenes, extractor), wanted),
        "diversity": float(np.mean([l1_deviation(one) for one in relative])),
        **{name: _mean_and_error(np.array(values)) for name, values in aligned.items() if values},
    }


def _latents(scenes: Sequence[Scene], extractor: MotionEncoder) -> Moments:
    features = torch.from_numpy(np.stack([scene.features for scene in scenes]))
    moved = from_features(scenes[0].skeleton, features)
    turns = quaternion_from_matrix(moved.rotations)
    return pooled(
        [
            moments(extractor.features(motion_features(turn, root)).numpy())
            for turn, root in zip(turns, moved.root, strict=True)
        ]
    )


def _mean_and_error(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    error = values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else 0.0
    return round(float(values.mean()), 5), round(float(error), 5)
