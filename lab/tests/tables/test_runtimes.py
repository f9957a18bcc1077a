from pathlib import Path
from types import SimpleNamespace

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar.bench.stream import StreamReport
from echoavatar_lab.tables import runtimes, scores
from echoavatar_lab.tables.runtimes import hardware


def test_hardware_is_named() -> None:
    assert "cores" in hardware("cpu")


TIMES = {"level": 1, "face": 9, "codec": 2, "generator": 4, "decoder": 8, "rig": 16, "feet": 32, "whole chunk": 72}


def test_stages_are_gathered_as_the_paper_does(monkeypatch: pytest.MonkeyPatch) -> None:
    report = StreamReport({k: (float(v), 2.0 * v, 3.0 * v) for k, v in TIMES.items()}, {})
    found = {name: runtimes._latency(report, name)["p50"].value for name in runtimes.PAPER_LATENCY}
    assert found == {
        "Audio Encoder": 3,
        "Audio-to-Motion Model": 4,
        "Motion Decoder": 8,
        "IK Post-processing": 48,
        "Total Latency": 72,
    }


def test_the_papers_stages_make_its_total_but_for_the_face() -> None:
    """169.15 of 177.43 ms on the H200: the paper does not say what the rest is."""
    for device in (0, 1):
        parts = sum(values[device] for name, values in runtimes.PAPER_LATENCY.items() if name != "Total Latency")
        assert parts < runtimes.PAPER_LATENCY["Total Latency"][device]


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
    monkeypatch.setattr(scores, "generation_scores", counted)
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

    monkeypatch.setattr(scores, "generation_scores", keep)
    experiment = Runs()
    experiment.sources = Runs.sources = SimpleNamespace(model=str(tiny_bundle))
    assert runtimes.waves(experiment) == []
    table = runtimes.make(experiment)
    assert len(table.lines) == 4
    assert table.notes[-1].startswith("default: what its bundle says, of ours level, lead-in")
    _, bare, paper, default = ([motion.rotations.tobytes() for motion in made] for made in scored)
    assert bare != default
    assert len(bare) == len(paper) == len(default) == len(experiment.test_clips)
