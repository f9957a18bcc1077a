"""The curves of a run: reward and its components, divergence, entropy by layer, and the held-out probes."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import CheckpointError


def gain(first: Mapping[str, Sequence[float]], later: Mapping[str, Sequence[float]]) -> tuple[float, float]:
    """By how much the reward of a measurement is over that of an earlier one: mean and standard error over prompts."""
    more = np.subtract(later["by_prompt"], first["by_prompt"])
    return float(more.mean()), float(more.std(ddof=1) / len(more) ** 0.5) if len(more) > 1 else 0.0


def draw_run(metrics: Path, picture: Path) -> None:
    """Draw `metrics.jsonl` of a run as a PNG.

    Raises:
        CheckpointError: there is no such file, or no step in it.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    try:
        lines = [json.loads(line) for line in metrics.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{metrics} holds no metrics ({error}); train first") from error
    steps, probes = [one for one in lines if "step" in one], [one for one in lines if "probe" in one]
    if not steps:
        raise CheckpointError(f"{metrics} holds no step; train first")
    figure, axes = plt.subplots(1, 4, figsize=(16, 3.6))
    at = [one["step"] for one in steps]
    for name in ("reward", "margin", "accuracy"):
        if name in steps[0]:
            axes[0].plot(at, [one[name] for one in steps], label=name)
    axes[0].set_title("training batches")
    for name in probes[0]["rewards"] if probes else ():
        means, errors = zip(*(one["rewards"][name] for one in probes), strict=True)
        axes[1].errorbar([one["probe"] for one in probes], means, errors, marker="o", capsize=3, label=name)
    if probes and all("by_prompt" in one for one in probes):
        means, errors = zip(*(gain(probes[0], one) for one in probes), strict=True)
        at_probes = [one["probe"] for one in probes]
        axes[1].errorbar(at_probes, means, errors, color="black", marker="s", capsize=3, label="gain")
    axes[1].set_title("held-out prompts, mean and standard error")
    axes[2].plot(at, [one["kl"] for one in steps])
    axes[2].set_title("KL from the reference, nats a code")
    for layer in range(len(steps[0]["entropy"])):
        axes[3].plot(at, [one["entropy"][layer] for one in steps], label=f"layer {layer}")
    axes[3].set_title("entropy by RVQ layer, nats")
    for axis in axes:
        axis.set_xlabel("step")
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(picture, dpi=100)
    plt.close(figure)
