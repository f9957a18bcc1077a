import json
from pathlib import Path

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.commands import reproduce
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
    realism, fits = (read_study(path.parent / f"{name}.yaml") for name in ("realism", "appropriateness"))
    assert (realism.muted, realism.questions) == (True, ("human_likeness",))
    assert [system.name for system in realism.systems] == ["Truth", "Ours", "EDGE"]
    assert (fits.muted, fits.questions) == (False, ("beat_matching",))
    assert {system.mismatched for system in fits.systems} == {None, "Truth", "Ours", "EDGE"}


def test_made_up_raters_judge_the_studies_from_end_to_end(tmp_path: Path, monkeypatch, capsys) -> None:
    """Clips, checks, exclusions and tables of all three; the design finds a system's own motion over its mismatch."""
    experiment = FakeExperiment()
    experiment.folder = tmp_path
    truth = experiment.true_motions
    experiment.foreign_motions = lambda: {"EDGE": truth}
    monkeypatch.setattr(user_study, "tuned", lambda experiment, method: TunedOutcome(truth, {}))
    monkeypatch.setattr(user_study, "RATERS", 8)
    path = user_study.write_study(experiment)
    (path.parent / "study.yaml").unlink()  # the paper's groups are many
    assert reproduce._simulate(path.parent) == 0
    said = capsys.readouterr().out
    found = [line for line in said.splitlines() if "Truth over Truth, mismatched" in line]
    assert len(found) == 2  # dance and gesture
    assert all(line.endswith(", found") for line in found)
    assert "nothing about the systems" in said
    told = json.loads((path.parent / "simulated/appropriateness/results.json").read_text())
    assert told["excluded"] >= 1  # who answers by lot fails a check
