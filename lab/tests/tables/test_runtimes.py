from pathlib import Path
from types import SimpleNamespace

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar_lab.tables import runtimes


class Runs(FakeExperiment):
    sources = SimpleNamespace(model=None)
    progress = None

    def again(self, *, runtime: str):
        other = Runs()
        other.runtime, other.asked = runtime, self.asked
        return other

    def generated_motions(self, choice):
        self.asked.append(f"{self.runtime} {choice.name}")
        return super().generated_motions(choice)


def test_one_generator_runs_in_three_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtimes, "generation_scores", counted)
    experiment = Runs()
    table = runtimes.make(experiment)
    assert [line.name for line in table.lines] == ["GT", "bare", "paper", "default"]
    name = runtimes.CHOICE.name
    assert [word for word in experiment.asked if " " in word] == [f"{how} {name}" for how in runtimes.RUNTIMES]
    assert "level" not in table.notes[-1]  # these generators hear sound as loud as it is


def test_a_bundle_runs_in_three_ways_on_the_same_clips(tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scored = []

    def keep(motions, clips, extractor, *, seed: int = 0):
        scored.append(motions)
        return counted(motions, clips, extractor, seed=seed)

    monkeypatch.setattr(runtimes, "generation_scores", keep)
    experiment = Runs()
    experiment.sources = Runs.sources = SimpleNamespace(model=str(tiny_bundle))
    assert runtimes.waves(experiment) == []
    table = runtimes.make(experiment)
    assert len(table.lines) == 4
    assert table.notes[-1].startswith("default: what its bundle says, of ours level, lead-in")
    _, bare, paper, default = ([motion.rotations.tobytes() for motion in made] for made in scored)
    assert bare != default
    assert len(bare) == len(paper) == len(default) == len(experiment.test_clips)
