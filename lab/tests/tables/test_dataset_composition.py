import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.tables import dataset_composition


def test_each_kind_is_scored_on_its_own_clips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset_composition, "generation_scores", counted)
    table = dataset_composition.make(FakeExperiment())
    merged = table.lines[-1]
    assert merged.ours["gesture_ba_g"].value == pytest.approx(2)  # ten times 2 clips of 10
    assert {"gesture_fid", "gesture_ba_g", "dance_fid", "dance_ba_d"} == merged.ours.keys()
    assert merged.paper == {"gesture_preference": 0.555, "dance_preference": 0.323}
    assert "Test clips: 2 of mostly speech, 2 of mostly music." in table.notes
