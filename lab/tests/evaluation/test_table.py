import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation.table import (
    Interval,
    Row,
    as_json,
    as_text,
    draw,
    interval,
    mean_interval,
    mean_rows,
    row_of_means,
)


def test_an_interval_of_a_mean_is_about_two_standard_errors_wide() -> None:
    """400 numbers of spread 1: the mean is known to 1.96 / 20."""
    values = np.random.default_rng(0).normal(5, 1, 400)
    low, high = mean_interval(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.12)


def test_it_holds_the_truth_nineteen_times_in_twenty() -> None:
    random = np.random.default_rng(1)
    held = 0
    for seed in range(200):
        low, high = mean_interval(random.normal(0, 1, 40), samples=400, seed=seed)
        held += low < 0 < high
    assert 0.89 < held / 200 < 0.99


def test_the_same_seed_gives_the_same_interval() -> None:
    values = np.arange(10.0)
    assert mean_interval(values, seed=3) == mean_interval(values, seed=3)
    assert mean_interval(values, seed=3) != mean_interval(values, seed=4)


def test_weights_count_and_clips_without_a_value_do_not() -> None:
    values, weights = np.array([0.0, 1.0, np.nan]), np.array([1e9, 1.0, 5.0])
    low, high = mean_interval(values, weights)
    assert low == 0
    assert high == 1  # a quarter of the resamples hold the second clip alone


def test_one_clip_has_no_interval() -> None:
    assert np.isnan(mean_interval(np.array([1.0]))).all()
    assert np.isnan(interval(lambda clips: 1.0, 1)).all()


def test_a_distance_is_centred_where_the_plain_interval_would_miss_it() -> None:
    """Distance of a sample's mean from zero: resamples scatter, so their distances are larger on the whole."""
    values = np.random.default_rng(0).normal(0, 1, (30, 200))

    def distance(clips: np.ndarray) -> float:
        return float((values[clips].mean(0) ** 2).sum())

    own = distance(np.arange(30))
    plain, centred = interval(distance, 30), interval(distance, 30, is_centred=True)
    assert plain.low > own
    assert centred.low < own < centred.high


def test_chance_is_taken_off_clip_by_clip() -> None:
    """Values 0.1 over a chance that scatters: the excess is known exactly, the value is not."""
    chances = np.random.default_rng(0).uniform(0.2, 0.8, 20)
    row = row_of_means("a", "", chances + 0.1, chances=chances, truth_chances=chances)
    assert row.excess == pytest.approx(0.1)
    assert row.excess_interval.low == pytest.approx(0.1)
    assert row.interval.high - row.interval.low > 0.1
    assert row.truth_chance == pytest.approx(chances.mean())


def test_clips_without_a_value_are_left_out_and_weights_count() -> None:
    row = row_of_means("a", "m", np.array([1.0, np.nan, 4.0]), weights=np.array([1.0, 9.0, 2.0]))
    assert row.value == pytest.approx(3.0)
    assert math.isnan(row_of_means("a", "m", np.array([np.nan])).value)


def test_text_has_a_line_a_metric_and_json_no_nan() -> None:
    rows = [Row("fid", "", 12.34567), Row("skate", "cm/s", 0.0001234)]
    lines = as_text(rows).splitlines()
    assert lines[0].split()[0] == "metric"
    assert lines[1].split() == ["fid", "12.346", *["-"] * 6]
    assert lines[2].split() == ["skate", "0.00012", *["-"] * 6, "cm/s"]
    told = json.loads(json.dumps(as_json(rows), allow_nan=False))
    assert told["fid"]["value"] == 12.3457
    assert told["fid"]["chance"] is None


ROWS = [
    Row("fid", "", 12.0, Interval(10.0, 15.0), truth=2.0),
    Row("ba_g_sharp", "", 0.4, Interval(0.3, 0.5), 0.35, 0.05, Interval(0.0, 0.1), 0.45, 0.33),
    Row("nothing", "m", float("nan")),
]


def test_a_picture_is_written_as_high_as_it_has_rows(tmp_path: Path) -> None:
    for count in (1, 3):
        draw(ROWS[:count], tmp_path / f"{count}.png", title="made against true")
    few, many = (Image.open(tmp_path / f"{count}.png") for count in (1, 3))
    assert many.height > few.height
    assert len(many.convert("RGB").getcolors(100_000)) > 20


def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(ROWS, tmp_path / "none" / "a.png", title="")
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(ROWS, tmp_path / "a.nonsense", title="")


def test_tables_of_several_performances_become_one_of_means() -> None:
    one, other = (Row("a", "m", v, Interval(v - 1, v + 1), chance=v / 2, truth=5.0) for v in (2.0, 4.0))
    (row,) = mean_rows([[one], [other]])
    assert row[:4] == ("a", "m", 3.0, Interval(2.0, 4.0))
    assert (row.chance, row.truth) == (1.5, 5.0)
    assert math.isnan(row.excess)
