"""Curves are drawn from what runs write."""

import json
from pathlib import Path

import pytest

from echoavatar.errors import CheckpointError
from echoavatar_lab.align.plots import draw_run, gain


def test_a_picture_of_a_run(tmp_path: Path):
    lines = [
        {"step": k, "loss": 0.0, "reward": 0.1 * k, "rewards.beats": 0.1, "kl": 0.01 * k, "entropy.0": 1.0}
        for k in range(1, 5)
    ]
    for step in (0, 4):
        held_out = {"rewards": {"beats": [0.1, 0.05]}, "by_prompt": [0.1, 0.2], "fid": 3.0 + step}
        lines.append({"step": step, "held_out": held_out | {"beat_alignment": [0.1, 0.02]}})
    (tmp_path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    draw_run(tmp_path / "metrics.jsonl", tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 10_000


def test_a_gain_is_taken_prompt_by_prompt():
    """Prompts differ by 10, the policy by 1 and 3: 2, give or take 1."""
    assert gain({"by_prompt": [0.0, 10.0]}, {"by_prompt": [1.0, 13.0]}) == pytest.approx((2.0, 1.0))


def test_no_metrics_are_named(tmp_path: Path):
    with pytest.raises(CheckpointError, match="holds no metrics"):
        draw_run(tmp_path / "none.jsonl", tmp_path / "run.png")
    (tmp_path / "empty.jsonl").write_text("")
    with pytest.raises(CheckpointError, match="holds no step"):
        draw_run(tmp_path / "empty.jsonl", tmp_path / "run.png")
