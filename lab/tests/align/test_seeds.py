"""Runs with several seeds as one line: by hand on small numbers."""

import pytest

from echoavatar_lab.align.seeds import as_markdown, over_seeds


def run(by_prompt, **more):
    reward = sum(by_prompt) / len(by_prompt)
    plain = {"kl": 0.1, "fid": 5.0, "diversity": 8.0, "stress_alignment": (0.2, 0.1)}
    return {"reward": (reward, 0.5), "rewards": {"a": (reward, 0.5)}, "by_prompt": by_prompt} | plain | more


BEGUN = run([0.0, 1.0, 2.0])
RUNS = [run([1.0, 2.0, 4.0], kl=0.2), run([1.0, 2.0, 2.0], fid=7.0)]


def test_spread_is_between_runs_and_error_over_prompts_of_their_mean():
    told = over_seeds(BEGUN, RUNS)
    assert told["runs"] == 2
    # means 7/3 and 5/3; by prompt 1, 2, 3, and 1, 1, 1 more than before
    assert told["reward"] == pytest.approx((2.0, (2 / 3) / 2**0.5, 1 / 3**0.5), abs=1e-5)
    assert told["gain"] == pytest.approx((1.0, (2 / 3) / 2**0.5, 0.0), abs=1e-5)
    assert told["kl"] == pytest.approx((0.15, 0.1 / 2**0.5), abs=1e-5)
    assert told["fid"] == pytest.approx((6.0, 2.0 / 2**0.5), abs=1e-5)
    assert told["stress_alignment"] == pytest.approx((0.2, 0.0))
    assert "beat_alignment" not in told  # no run met a beat
    assert over_seeds(BEGUN, RUNS[:1])["gain"] == pytest.approx((4 / 3, 0.0, 1 / 3), abs=1e-5)


def test_the_table_has_a_line_for_the_truth_the_untuned_and_every_method():
    truth = {name: value for name, value in BEGUN.items() if name not in ("kl", "by_prompt")}
    rows = as_markdown({"truth": truth, "untuned": BEGUN}, {"two": over_seeds(BEGUN, RUNS)}).splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert {len(row) for row in cells} == {8}
    assert cells[0] == [
        "", "reward", "gain", "a", "KL, nats a code", "FID", "diversity, m", "stresses over chance"
    ]  # fmt: skip
    assert cells[2] == ["true motion", "1.00 +- 0.50", "", "1.00", "", "5.0", "8.00", "0.20 +- 0.10"]
    assert cells[3][:4] == ["untuned", "1.00 +- 0.50", "", "1.00"]
    assert cells[4][:4] == ["two", "2.00 +- 0.58 (0.47)", "+1.00 +- 0.00 (0.47)", "2.00 (0.47)"]
    assert cells[4][4:] == ["0.150 (0.071)", "6.0 (1.4)", "8.00 (0.00)", "0.20 (0.00)"]
