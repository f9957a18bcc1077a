from pathlib import Path

import numpy as np
import pytest
from lab.tests.evaluation.test_takes import name_people

from echoavatar.cli import main
from echoavatar.motion.formats import write_bvh
from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse
from echoavatar_lab.data import Corpus
from echoavatar_lab.evaluation.people import of_card


def test_a_corpus_is_made_and_completed(tmp_path: Path) -> None:
    """0.02 hours are two clips, the fewest there are; a second run finds nothing to do."""
    words = ["data", "rehearse", "--hours", "0.02", "--seed", "3", "-o", str(tmp_path), "--workers", "1"]
    assert main(words) == 0
    corpus = Corpus(tmp_path)
    assert len(corpus.names()) == 2
    before = [corpus.path(name).stat().st_mtime_ns for name in corpus.names()]
    assert main(words) == 0
    assert [corpus.path(name).stat().st_mtime_ns for name in corpus.names()] == before


def test_a_corpus_can_be_measured_and_looked_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rehearse(Plan(hours=0.001, seed=4, folder=tmp_path, clip_seconds=20.0))
    assert main(["data", "describe", str(tmp_path)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].split() == ["speech", "music", "silence"]
    assert any(line.startswith("wrist_speed_mean_m_s") for line in table)
    alive = next(line for line in table if line.startswith("hand_speed"))
    named = of_card()["speech"]["hand_speed"]
    assert f"{named.mean:.3g} ({named.low:.3g} to {named.high:.3g})" in alive
    assert not any(line.startswith("told apart") for line in table)
    assert main(["data", "preview", str(tmp_path), "-o", str(tmp_path / "p"), "--clips", "1", "--seconds", "0.5"]) == 0
    assert sorted(path.suffix for path in (tmp_path / "p").iterdir()) == [".mp4", ".png"]


def test_a_corpus_is_told_apart_from_captured_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bodies that stand still are told from nearly all clips of the corpus."""
    rehearse(Plan(hours=0.02, seed=4, folder=tmp_path / "corpus", clip_seconds=40.0))
    corpus = Corpus(tmp_path / "corpus")
    (tmp_path / "people" / "dance").mkdir(parents=True)
    for name in corpus.names(has_mirrored=False):
        clip = corpus.load(name)
        still = np.repeat(clip.rotations[:1], 900, axis=0), np.repeat(clip.root[:1], 900, axis=0)
        write_bvh(tmp_path / "people" / "dance" / f"{name}.bvh", corpus.skeleton, *still, 30.0)
    names = corpus.names(has_mirrored=False)
    name_people(tmp_path / "people", *(("music", name, "any", f"dance/{name}") for name in names))
    assert main(["data", "describe", str(tmp_path / "corpus"), "--captured", str(tmp_path / "people")]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[-4] == ["told", "apart", "corpus", "people"]
    assert [row[0] for row in rows[-3:]] == ["speech", "music", "silence"]
    assert float(rows[-2][1]) > 0.9
    assert rows[-3][1:] == rows[-1][1:] == ["nan", "nan"]  # nobody speaks or waits
