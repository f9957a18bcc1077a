import json
from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.cli import build_parser, main
from echoavatar_lab.corpora.rehearsal.corpus import Plan, rehearse


def test_the_last_line_is_json(tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rehearse(Plan(hours=16 * 8 / 3600, seed=2, folder=tmp_path, clip_seconds=8.0))
    assert main(["evaluate", str(tiny_bundle), "--corpus", str(tmp_path), "--repeats", "1"]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    assert json.loads(said[-1])["codes_mpjpe_body"]["value"] > 0
    assert any(line.startswith("skate ") for line in said)


def test_a_measure_has_the_options_before_and_behind_its_name() -> None:
    parser = build_parser(["evaluate"])
    for words in (["--clips", "3", "alive"], ["alive", "--clips", "3"], ["--clips", "5", "alive", "--clips", "3"]):
        args = parser.parse_args(["evaluate", "mine", *words])
        assert (args.model, args.measure, args.clips, args.seed) == ("mine", "alive", 3, 0)
    assert parser.parse_args(["evaluate", "mine"]).measure is None


@pytest.mark.parametrize("given", ["0", "twice"])
def test_no_performance_at_all_is_refused(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["evaluate", "default", "--repeats", given])
    assert f"'{given}' is not a number from 1 on" in capsys.readouterr().err


def test_actions_of_the_head_are_told_by_how_far_it_turns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two actions of the shipped library, one of the head: both in the table, its turns in a second one and in JSON."""
    from echoavatar_lab.evaluation import actions

    every = actions.evaluate_actions
    monkeypatch.setattr(
        actions,
        "evaluate_actions",
        lambda pipeline, audio, *, seeds: every(pipeline, audio, ["bow", "look_around"], seeds=seeds[:1]),
    )
    assert main(["evaluate", "default", "actions"]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    told = json.loads(said[-1])
    assert set(told["off_on_cm"]) == {"bow", "look_around"}
    (turns,) = told["head_off_on_clip_deg"].values()
    off, on, own = turns["yaw"]
    assert on > off + 10
    assert own == pytest.approx(126, abs=5)
    assert said[-2].split() == ["look_around", *(f"{turn:.0f}" for way in turns.values() for turn in way)]


def test_liveliness_needs_recordings_and_ends_with_json(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from echoavatar_lab.evaluation import alive

    monkeypatch.setattr(alive, "contact_sheet", lambda *_, **__: np.zeros((4, 4, 3), np.uint8))
    assert main(["evaluate", str(tiny_bundle), "alive"]) == 1
    assert "--recordings" in capsys.readouterr().err
    soundfile.write(tmp_path / "voice.wav", np.random.default_rng(0).normal(0, 0.1, 5 * 24_000), 24_000)
    card = tmp_path / "card.json"
    card.write_text('{"name": "mine"}', "utf-8")
    asked = ["--recordings", str(tmp_path), "--seconds", "5", "--pictures", str(tmp_path / "a.png")]
    asked += ["--card", str(card)]
    assert main(["evaluate", str(tiny_bundle), "alive", *asked]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    speed = json.loads(said[-1])["speech"]["hand_speed"]
    assert speed >= 0
    told = json.loads(card.read_text("utf-8"))
    assert (told["name"], told["alive"]["speech"]["hand_speed"]) == ("mine", speed)
    assert main(["evaluate", str(tiny_bundle), "alive", *asked[:-1], str(tmp_path / "none.json")]) == 1
    assert "none.json" in capsys.readouterr().err
    assert (tmp_path / "a.png").exists()
    assert (tmp_path / "a_plot.png").exists()
    assert main(["evaluate", str(tiny_bundle), "alive", *asked, "--repeats", "2"]) == 0
    told = json.loads(card.read_text("utf-8"))["alive"]
    assert told["command"].endswith("--repeats 2")
    assert "hand_speed" in told["speech, scatter"]


def test_a_corpus_without_test_clips_is_refused(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rehearse(Plan(hours=0.001, seed=2, folder=tmp_path, clip_seconds=8.0))
    assert main(["evaluate", str(tiny_bundle), "--corpus", str(tmp_path)]) == 1
    assert "no test clips" in capsys.readouterr().err
