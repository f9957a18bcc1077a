import pytest
from tests.reproduce.bench import FakeWorkshop, counted

from echoavatar.reproduce import main


def test_every_generator_and_baseline_has_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "generated", counted)
    workshop = FakeWorkshop()
    table = main.make(workshop)
    assert workshop.asked == ["corruption-none", "corruption-uniform", "body-parts"]
    lines = {line.name: line for line in table.lines}
    assert lines["GT"].ours["fid"].value < 1e-6 < lines["Mean pose"].ours["fid"].value
    assert lines["MECo"].paper["fid"] == 14.73
    assert not lines["MECo"].ours
    assert "fid" not in lines["Ours (uniform corruption)"].paper
