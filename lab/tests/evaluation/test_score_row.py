import json
import math

import numpy as np
import pytest

from echoavatar_lab.evaluation.score_row import Row, as_json, as_text, row_of_means


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
