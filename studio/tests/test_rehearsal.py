"""Made-up raters; a whole study of theirs is judged in lab/tests/tables/test_user_study.py."""

import pytest
from studio.tests import canned

from echoavatar_studio.rehearsal import MISMATCH, STEP, Found, as_text, made_up_worth
from echoavatar_studio.settings import parse_study


def found(mean: float, half: float | None, gap: float = 0.4) -> Found:
    return Found("A", "B", "all", "overall_preference", gap, mean, half)


def test_each_system_is_worth_less_than_the_one_before_and_mismatched_motion_less_than_its_own():
    systems = [{"name": "A", "clips": "a"}, {"name": "B", "clips": "b"}, {"name": "A elsewhere", "mismatched": "A"}]
    worth = made_up_worth(parse_study(canned.pairwise_text(systems=systems)))
    assert worth == pytest.approx({"A": 0, "B": -STEP, "A elsewhere": -MISMATCH})


def test_a_preference_is_found_where_the_interval_excludes_none_and_the_sign_is_right():
    assert found(0.5, 0.2).is_right
    assert not found(0.1, 0.2).is_right
    assert not found(-0.5, 0.2).is_right
    assert not found(0.5, None).is_right
    text = as_text([found(0.5, 0.2), found(0.1, None)])
    assert "made up +0.40, mean +0.50 +- 0.20, found" in text
    assert text.endswith("1 of 2 preferences found")
