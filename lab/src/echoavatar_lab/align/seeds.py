"""Summarises runs of one method with different seeds: mean, deviation between runs, standard error over prompts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .motion_metrics import Measurements, mean_and_error
from .plots import gain

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
