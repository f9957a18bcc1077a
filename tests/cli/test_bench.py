import json
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.motion.ik import HandCollisions
from echoavatar.motion.stages.feet import Feet


def test_the_last_line_is_json_with_the_promised_keys(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "stream", "--model", str(tiny_bundle), "--seconds", "2"]) == 0
    said = capsys.readouterr().out.strip().splitlines()
    result = json.loads(said[-1])
    wanted = {"rtf", "chunk_ms_p50", "chunk_ms_p99", "first_motion_ms", "rss_mb_start", "rss_mb_end"}
    assert wanted <= result.keys()
    assert result["first_motion_ms"] > 266
    for stage in ("codec", "generator", "decoder"):
        assert any(line.startswith(stage) for line in said)


def test_a_stage_left_out_is_not_run(
    tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = []
    monkeypatch.setattr(Feet, "step", lambda *_, **__: ran.append("feet"))
    monkeypatch.setattr(HandCollisions, "resolve", lambda *_: ran.append("hands"))
    common = ["bench", "stream", "--model", str(tiny_bundle), "--seconds", "2", "--without", "feet"]
    assert main(common) == 0
    assert set(ran) == {"hands"}
    assert main([*common, "--without", "toes"]) == 1
    assert "no stage 'toes'" in capsys.readouterr().err


@pytest.mark.parametrize("counts", ["0,2", "2,many"])
def test_impossible_numbers_of_sessions_are_refused_in_words(counts: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bench", "sessions", "--counts", counts])
    assert "give numbers of sessions from 1 on" in capsys.readouterr().err
