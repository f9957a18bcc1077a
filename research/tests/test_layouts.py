import pytest
from research.tests.bench import FakeWorkshop, counted

from echoavatar_research import layouts


def test_both_orders_are_trained_and_nothing_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layouts, "generated", counted)
    workshop = FakeWorkshop()
    table = layouts.make(workshop)
    assert workshop.asked == ["order-prefix", "order-interleaved"]
    assert all({"fid", "ba_g", "ba_d"} <= line.ours.keys() and not line.paper for line in table.lines)
