import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.tables import layouts


def test_both_orders_are_trained_and_nothing_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layouts, "generation_scores", counted)
    experiment = FakeExperiment()
    table = layouts.make(experiment)
    assert experiment.asked == ["order-prefix", "order-interleaved"]
    assert all({"fid", "ba_g", "ba_d"} <= line.ours.keys() and not line.paper for line in table.lines)
