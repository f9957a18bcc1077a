"""Draws the curves of a run: reward and components, divergence, entropy by RVQ layer, held-out measurements."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from echoavatar.errors import CheckpointError


def gain(first: Mapping[str, Any], later: Mapping[str, Any]) -> tuple[float, float]:
    """Increase in reward between two measurements: mean and standard error over prompts."""
    more = np.subtract(later["by_prompt"], first["by_prompt"])
    return float(more.mean()), float(more.std(ddof=1) / len(more) ** 0.5) if len(more) > 1 else 0.0


def draw_run(metrics: Path, picture: Path) -> None:
    """Draw the `metrics.jsonl` of a run as a PNG.

    Raises:
        CheckpointError: the file is missing or holds no step.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    try:
        lines = [json.loads(line) for line in metrics.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{metrics} holds no metrics ({error}); train first") from error
    steps = [one for one in lines if "loss" in one]
    probes = [one["held_out"] | {"step": one["step"]} for one in lines if "held_out" in one]
    if not steps:
        raise CheckpointError(f"{metrics} holds no step; train first")
    figure, grid = plt.subplots(2, 3, figsize=(14, 7.2))
    batches, held_out, components, divergence, entropy, cost = grid.flat
    at, measured = [one["step"] for one in steps], [one["step"] for one in probes]
    for name in ("reward", "margin", "accuracy"):
        if name in steps[0]:
            batches.plot(at, [one[name] for one in steps], label=name)
    batches.set_title("training batches")
    for name in (name for name in steps[0] if name.startswith("rewards.")):
        components.plot(at, [one[name] for one in steps], label=name.removeprefix("rewards."))
    components.set_title("training batches, by component")
    for name in probes[0]["rewards"] if probes else ():
        means, errors = zip(*(one["rewards"][name] for one in probes), strict=True)
        held_out.errorbar(measured, means, errors, marker="o", capsize=3, label=name)
    if probes:
        means, errors = zip(*(gain(probes[0], one) for one in probes), strict=True)
        held_out.errorbar(measured, means, errors, color="black", marker="s", capsize=3, label="gain")
    held_out.set_title("held-out prompts, mean and standard error")
    divergence.plot(at, [one["kl"] for one in steps])
    divergence.set_title("KL from the reference, nats a code")
    for layer, name in enumerate(name for name in steps[0] if name.startswith("entropy.")):
        entropy.plot(at, [one[name] for one in steps], label=f"layer {layer}")
    entropy.set_title("entropy by RVQ layer, nats")
    _draw_cost(cost, measured, probes)
    for axis in grid.flat:
        axis.set_xlabel("step")
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(picture, dpi=100)
    plt.close(figure)


def _draw_cost(axis: Any, at: Sequence[int], probes: Sequence[Mapping[str, Any]]) -> None:
    """FID on the left axis, beat and stress alignment minus chance on the right."""
    axis.set_title("held-out: FID (left), alignment over chance (right)")
    if not probes or "fid" not in probes[0]:
        return
    shown = axis.plot(at, [one["fid"] for one in probes], "o-", color="black")
    names, other = ["FID"], axis.twinx()
    for name in ("beat_alignment", "stress_alignment"):
        if all(name in one for one in probes):
            means, errors = zip(*(one[name] for one in probes), strict=True)
            shown.append(other.errorbar(at, means, errors, marker=".", capsize=3))
            names.append(name)
    other.legend(shown, names, fontsize=7)
