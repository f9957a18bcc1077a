from pathlib import Path

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.evaluation.motion_folder import motion_files
from echoavatar_lab.tables import scores, user_study
from echoavatar_lab.tables.alignment import TunedOutcome
from echoavatar_studio.settings import read_study
from echoavatar_studio.sources import read_sounds


def test_each_kind_is_scored_on_its_own_clips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    table = user_study.make(FakeExperiment())
    merged = table.lines[-1]
    assert merged.ours["gesture_ba_g"].value == pytest.approx(2)  # ten times 2 clips of 10
    assert {"gesture_fid", "gesture_ba_g", "dance_fid", "dance_ba_d"} == merged.ours.keys()
    assert merged.paper == {"gesture_preference": 0.555, "dance_preference": 0.323}
    assert "Test clips: 2 of mostly speech, 2 of mostly music." in table.notes


def test_the_package_is_a_study_of_the_studio(tmp_path: Path, monkeypatch) -> None:
    experiment = FakeExperiment()
    experiment.folder = tmp_path
    truth = experiment.true_motions
    experiment.foreign_motions = lambda: {"EDGE": truth}
    monkeypatch.setattr(user_study, "tuned", lambda experiment, method: TunedOutcome(truth, {}))
    path = user_study.write_study(experiment)
    study = read_study(path)
    groups = [system.group for system in study.systems]
    assert groups.count("Comparison with SOTA") == 2
    assert groups.count("Dataset Composition") == 3
    cuts = read_sounds(study.sounds, path.parent, seconds=study.seconds)
    assert sorted(cut.category for cut in cuts) == ["dance", "dance", "gesture", "gesture"]
    for system in study.systems:
        assert set(motion_files(path.parent / system.clips)) == {cut.stem for cut in cuts}
