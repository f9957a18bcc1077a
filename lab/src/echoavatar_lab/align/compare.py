"""Compares generators on the same held-out prompts with the same seeds: what tuning gained and what it cost.

Rewards are means over prompts with standard errors; gains over the first generator are taken prompt by prompt. Also
reported: FID against the prompts' true motion, diversity, beat alignment minus chance, and KL from the first generator.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from echoavatar.models.generator import Generator
from echoavatar.models.tokenizer import BodyTokenizer
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder

from .judge import DecodingJudge
from .motion_metrics import Measurements, MotionMetrics, mean_and_error
from .plots import gain
from .policy import GeneratorPolicy, check_reference
from .probe import Probe
from .prompts import Prompt
from .rewards import RewardMix


def compare(
    generators: Mapping[str, Generator],
    tokenizer: BodyTokenizer,
    prompts: Sequence[Prompt],
    mix: RewardMix,
    extractor: MotionEncoder,
    *,
    group: int = 4,
    seed: int = 0,
    device: str = "cpu",
) -> dict[str, Measurements]:
    """Measurements by generator name, the true motion's first; generators are moved to `device`.

    Raises:
        CheckpointError: the generators have different vocabularies.
    """
    first = next(iter(generators.values()))
    for name, generator in generators.items():
        check_reference(generator, first, name=name)
    assert mix.reference_statistics is not None, "a comparison needs the reference statistics"
    motion_metrics = MotionMetrics(tokenizer, prompts, extractor, mix.reference_statistics)
    probe = Probe(prompts, DecodingJudge(tokenizer, mix), group=group, motion_metrics=motion_metrics, seed=seed)
    true = mix(motion_metrics.truth)
    told: dict[str, Measurements] = {
        "truth": {
            "reward": mean_and_error(true.total),
            "rewards": {name: mean_and_error(values) for name, values in true.parts.items()},
            **motion_metrics(motion_metrics.truth),
        }
    }
    begun: dict[str, Any] = {}
    reference = GeneratorPolicy(first.eval().to(device))
    for name, generator in generators.items():
        found: dict[str, Any] = probe(GeneratorPolicy(generator.eval().to(device)), reference)
        found.pop("seconds")
        begun = begun or found
        told[name] = found | {"gain": gain(begun, found)}
    return told
