import json
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.corpora.rehearsal.corpus import Plan, rehearse

pytest.importorskip("librosa", reason="the evaluate extra is not installed")


def test_the_last_line_is_json(tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rehearse(Plan(hours=16 * 8 / 3600, seed=2, folder=tmp_path, clip_seconds=8.0))
    assert main(["evaluate", str(tiny_bundle), "--corpus", str(tmp_path), "--repeats", "1"]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    assert json.loads(said[-1])["mpjpe_body_mm"] > 0
    assert any(line.startswith("skate_cm_s") for line in said)


def test_no_performance_at_all_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["evaluate", "default", "--repeats", "0"])
    assert "at least once, got 0" in capsys.readouterr().err


def test_actions_of_the_head_are_told_by_how_far_it_turns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two actions of the shipped library, one of the head: both in the table, its turns in a second one and in JSON."""
    from echoavatar.evaluation import actions

    every = actions.evaluate_actions
    monkeypatch.setattr(
        actions,
        "evaluate_actions",
        lambda pipeline, audio, *, seeds: every(pipeline, audio, ["bow", "disagree"], seeds=seeds[:1]),
    )
    assert main(["evaluate", "default", "--actions"]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    told = json.loads(said[-1])
    assert set(told["off_on_cm"]) == {"bow", "disagree"}
    (turns,) = told["head_off_on_clip_deg"].values()
    off, on, own = turns["yaw"]
    assert on > 2 * off
    assert own == pytest.approx(48, abs=5)
    assert said[-2].split() == ["disagree", *(f"{turn:.0f}" for way in turns.values() for turn in way)]


def test_a_corpus_without_test_clips_is_refused(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rehearse(Plan(hours=0.001, seed=2, folder=tmp_path, clip_seconds=8.0))
    assert main(["evaluate", str(tiny_bundle), "--corpus", str(tmp_path)]) == 1
    assert "no test clips" in capsys.readouterr().err
