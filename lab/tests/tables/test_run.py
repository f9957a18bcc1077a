from types import SimpleNamespace

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.tables import scores
from echoavatar_lab.tables.run import INTERVALS, NOTHING_LEARNED, reproduce


def test_a_table_ends_with_what_it_was_made_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    experiment = FakeExperiment()
    manifest = SimpleNamespace(info={"kind": "sways"})
    experiment.corpus = SimpleNamespace(manifest=manifest, frames=lambda: 2 * 60 * 30)
    notes = reproduce("layouts", experiment, command="echoavatar reproduce layouts").notes
    assert {INTERVALS, NOTHING_LEARNED, "4 test clips of sways, 2 minutes in all."} <= set(notes)
    made, runtime = notes[-2:]
    assert made.startswith("Made by `echoavatar reproduce layouts` on ")
    assert "; commit " in made
    assert runtime == "Runtime: paper."
