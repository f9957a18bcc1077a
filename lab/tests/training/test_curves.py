import json
import os
from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.training.curves import Curve, draw, is_wide, read_curves, smoothed


def told(folder: Path, count: int = 60) -> Path:
    folder.mkdir()
    lines = [
        {"step": n, "loss": 100 / n, "rate": 1e-3, "seconds": 0.1, "usage": {"upper": 0.5, "all": [1, 2]}}
        for n in range(1, count + 1)
    ]
    lines.insert(3, {"step": 3, "held_out": 2.0})
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / "metrics.jsonl").write_text(text + '{"step": 61, "lo')
    return folder


def test_nested_numbers_are_read_and_a_cut_off_line_is_skipped(tmp_path: Path) -> None:
    curves = read_curves(told(tmp_path / "run"))
    assert set(curves) == {"loss", "rate", "held_out", "usage.upper"}
    assert curves["loss"].steps[[0, -1]].tolist() == [1, 60]
    assert curves["held_out"].values.tolist() == [2.0]


def test_of_held_out_prompts_the_means_are_read(tmp_path: Path) -> None:
    found = {"reward": [0.5, 0.1], "rewards": {"beats": [0.2, 0.1]}, "by_prompt": [0.4, 0.5, 0.6], "fid": 3.0}
    (tmp_path / "metrics.jsonl").write_text(json.dumps({"step": 1, "held_out": found}) + "\n")
    curves = {name: curve.values.tolist() for name, curve in read_curves(tmp_path).items()}
    assert curves == {"held_out.reward": [0.5], "held_out.rewards.beats": [0.2], "held_out.fid": [3.0]}


def test_smoothing_is_a_mean_around_each_value_and_keeps_a_line_straight_inside() -> None:
    """Of 0, 3, 6, 9 over three: the ends see two, so 1.5 and 7.5."""
    assert smoothed(np.array([0.0, 3, 6, 9]), 3).tolist() == [1.5, 3, 6, 7.5]
    assert smoothed(np.array([4.0]), 9).tolist() == [4.0]


def test_scales_are_logarithmic_where_values_span_more_than_a_decade() -> None:
    steps = np.arange(3.0)
    assert is_wide([Curve(steps, np.array([100.0, 10, 1]))])
    assert not is_wide([Curve(steps, np.array([3.0, 2, 1]))])
    assert not is_wide([Curve(steps, np.array([100.0, 1, 0]))])


def test_runs_are_drawn_side_by_side(tmp_path: Path) -> None:
    runs = {"a": read_curves(told(tmp_path / "a")), "b": read_curves(told(tmp_path / "b", 20))}
    draw(runs, tmp_path / "all.png")
    draw(runs, tmp_path / "one.svg", metrics=["loss"])
    assert (tmp_path / "all.png").stat().st_size > 10_000
    text = (tmp_path / "one.svg").read_text()
    assert text.count('<g id="axes_') == 1


def test_names_with_a_dollar_are_shown_as_they_are(tmp_path: Path) -> None:
    curves = {"loss $x_{$": Curve(np.arange(3.0), np.arange(3.0))}
    draw({"a$^{$": curves, "b": curves}, tmp_path / "all.svg")
    assert "<!-- loss $x_{$ -->" in (tmp_path / "all.svg").read_text()
    with pytest.raises(EchoAvatarError, match="300 metrics are more than 200 plots; choose with --metrics"):
        draw({"a": dict.fromkeys(map(str, range(300)), curves["loss $x_{$"])}, tmp_path / "many.svg")


@pytest.mark.parametrize("kind", ["pipe", "endless"])
def test_what_is_no_regular_file_is_refused_unread(tmp_path: Path, kind: str) -> None:
    if kind == "pipe":
        os.mkfifo(tmp_path / "metrics.jsonl")
    else:
        (tmp_path / "metrics.jsonl").symlink_to("/dev/zero")
    with pytest.raises(EchoAvatarError, match="not a regular file"):
        read_curves(tmp_path)


def test_drawing_errors_name_the_cause(tmp_path: Path) -> None:
    runs = {"a": read_curves(told(tmp_path / "a"))}
    with pytest.raises(EchoAvatarError, match="no run has the metric los; there are loss"):
        draw(runs, tmp_path / "x.png", metrics=["los"])
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(runs, tmp_path / "none" / "x.png")
    with pytest.raises(EchoAvatarError, match=r"metrics\.jsonl cannot be read .*give the folder of a run"):
        read_curves(tmp_path)
    (tmp_path / "metrics.jsonl").write_text("")
    with pytest.raises(EchoAvatarError, match="holds no metrics yet"):
        read_curves(tmp_path)
