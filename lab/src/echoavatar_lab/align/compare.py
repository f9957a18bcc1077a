"""Compares generators on the same held-out prompts with the same seeds: what tuning gained and what it cost.

Rewards are means over prompts with standard errors; gains over the first generator are taken prompt by prompt. Also
reported: FID against the prompts' true motion, diversity, beat alignment minus chance, and KL from the first generator.
Runs of one method with different seeds are one line (`over_seeds`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoder
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.tokenizer.model import BodyTokenizer

from .policy import GeneratorPolicy, check_reference
from .probe import DecodingJudge, Measurements, MotionMetrics, Probe, mean_and_error
from .prompts import Prompt
from .rewards import RewardMix


def gain(first: Mapping[str, Any], later: Mapping[str, Any]) -> tuple[float, float]:
    """Increase in reward between two measurements: mean and standard error over prompts."""
    more = np.subtract(later["by_prompt"], first["by_prompt"])
    return float(more.mean()), float(more.std(ddof=1) / len(more) ** 0.5) if len(more) > 1 else 0.0


PLAIN = ("kl", "fid", "diversity")
ALIGNED = ("beat_alignment", "stress_alignment")
TITLES = {
    "kl": "KL, nats a code",
    "fid": "FID",
    "diversity": "diversity, m",
    "beat_alignment": "beats over chance",
    "stress_alignment": "stresses over chance",
}


def over_seeds(begun: Mapping[str, Any], runs: Sequence[Mapping[str, Any]]) -> Measurements:
    """Several measurements by `compare` on the same prompts as one.

    `reward` and `gain` over `begun` are (mean, deviation, error): the standard deviation between runs, and the standard
    error over prompts of the runs' mean, because all runs share the prompts. The rest is (mean, deviation).
    """
    by_prompt = np.mean([run["by_prompt"] for run in runs], axis=0)
    mean, error = mean_and_error(by_prompt)
    more, more_error = gain(begun, {"by_prompt": by_prompt.tolist()})
    gains = [gain(begun, run)[0] for run in runs]
    return {
        "runs": len(runs),
        "reward": (mean, _spread([run["reward"][0] for run in runs])[1], error),
        "gain": (_rounded(more), _spread(gains)[1], _rounded(more_error)),
        "rewards": {name: _spread([run["rewards"][name][0] for run in runs]) for name in runs[0]["rewards"]},
        **{name: _spread([run[name] for run in runs]) for name in PLAIN},
        **{name: _spread([run[name][0] for run in runs]) for name in ALIGNED if name in runs[0]},
    }


def as_markdown(found: Mapping[str, Any], lines: Mapping[str, Mapping[str, Any]]) -> str:
    """A table: the truth and the first generator of `found`, then `lines` from `over_seeds`."""
    truth, untuned = found["truth"], found[next(name for name in found if name != "truth")]
    names = list(truth["rewards"])
    aligned = [name for name in ALIGNED if name in truth]
    heads = ["", "reward", "gain", *names, *(TITLES[name] for name in (*PLAIN, *aligned))]
    rows = [heads, ["---", *["---:"] * (len(heads) - 1)]]
    for name, one in (("true motion", truth), ("untuned", untuned)):
        cells = [name, _told(*one["reward"]), "", *(_told(one["rewards"][part][0]) for part in names)]
        cells += [_told(one[part], digits=_digits(part)) if part in one else "" for part in PLAIN]
        rows.append([*cells, *(_told(*one[part]) for part in aligned)])
    for name, line in lines.items():
        reward, more = line["reward"], line["gain"]
        cells = [
            name,
            _told(reward[0], reward[2], reward[1]),
            _told(more[0], more[2], more[1], sign="+"),
            *(_told(line["rewards"][part][0], None, line["rewards"][part][1]) for part in names),
            *(_told(line[part][0], None, line[part][1], digits=_digits(part)) for part in PLAIN),
            *(_told(line[part][0], None, line[part][1]) for part in aligned),
        ]
        rows.append(cells)
    return "".join("| " + " | ".join(row) + " |\n" for row in rows)


def _told(
    value: float, error: float | None = None, spread: float | None = None, *, digits: int = 2, sign: str = ""
) -> str:
    """A value, its standard error over prompts, and in brackets the deviation between runs."""
    words = [f"{value:{sign}.{digits}f}"]
    if error is not None:
        words.append(f"+- {error:.{digits}f}")
    if spread is not None:
        words.append(f"({spread:.{digits}f})")
    return " ".join(words)


def _digits(name: str) -> int:
    return {"kl": 3, "fid": 1}.get(name, 2)


def _spread(values: Sequence[float]) -> tuple[float, float]:
    """Mean, and standard deviation between runs (0 for a single run)."""
    return _rounded(np.mean(values)), _rounded(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _rounded(value: Any) -> float:
    return round(float(value), 5)


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

    Raises CheckpointError if the generators have different vocabularies.
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
