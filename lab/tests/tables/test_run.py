from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from lab.tests.fakes import FakeExperiment, counted

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.tables import alignment, main, scores, tokenizer_ablation
from echoavatar_lab.tables.experiment import Experiment, Sources
from echoavatar_lab.tables.run import INTERVALS, NOTHING_LEARNED, PAPERS, make_in_waves, reproduce
from echoavatar_lab.tables.scale import PAPER, TINY, GeneratorChoice, generator_waves


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


def test_what_is_not_the_papers_at_its_scale_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scores, "generation_scores", counted)
    experiment = FakeExperiment()
    experiment.scale, experiment.sources = PAPER, Sources(qwen=Path("qwen"))
    experiment.corpus = SimpleNamespace(manifest=SimpleNamespace(info={"kind": "sways"}), frames=lambda: 3600)
    told = [note for note in reproduce("layouts", experiment, command="c").notes if note.startswith("Not the paper's")]
    assert told == [PAPERS["codec"]]


def leave(experiment: Experiment, name: str) -> None:
    (experiment.folder / name).write_text(str(experiment.seed))


def fail(experiment: Experiment) -> None:
    raise EchoAvatarError("this part cannot be made; try another")


def test_what_a_part_needs_is_in_an_earlier_wave() -> None:
    first = GeneratorChoice("first")
    waves = generator_waves([first, GeneratorChoice("second", after=first), first])
    assert [len(wave) for wave in waves] == [1, 1, 1, 1]
    experiment = Experiment(Path("unused"), TINY)
    assert [len(wave) for wave in main.waves(experiment)] == [1, 1, 4, 1]
    assert [len(wave) for wave in tokenizer_ablation.waves(experiment)] == [6, 6, 6, 0]
    assert [len(wave) for wave in alignment.waves(experiment)] == [1, 1, 1, 0, 1, 3]


@pytest.mark.slow
def test_parts_are_made_in_other_processes_and_an_error_comes_back(tmp_path: Path) -> None:
    said: list[str] = []
    experiment = Experiment(tmp_path, TINY, seed=5, say=said.append)
    make_in_waves([[partial(leave, name="a"), partial(leave, name="b")]], [experiment], processes=2)
    assert [(tmp_path / name).read_text() for name in "ab"] == ["5", "5"]
    assert said[-1] == "wave 1 of 1: 2 of 2 parts"
    with pytest.raises(EchoAvatarError, match="cannot be made; try another"):
        make_in_waves([[fail]], [experiment], processes=2)
