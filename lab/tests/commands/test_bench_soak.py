import json
from pathlib import Path
from typing import Any

import pytest

from echoavatar.cli import main
from echoavatar_lab.bench import soak

WHOLE = {
    "stale": 0, "doubled": 0, "missing": 0, "lost": 2, "failed_by_us": 2, "turns": 7, "slope_mb_an_hour": 1.5,
    "memory_mb": [[0.0, 500.0], [30.0, 510.0], [60.0, 512.0]],
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "code"),
    [({}, 0), ({"stale": 1}, 1), ({"doubled": 1}, 1), ({"missing": 1}, 1), ({"lost": 3}, 1), ({"lost": 0}, 0)],
)
def test_it_asks_for_what_was_asked_and_fails_when_a_session_is_not_whole(
    changes: dict[str, int], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    asked: list[Any] = []

    def measured(model: str, *, progress: Any, **how: Any) -> dict[str, Any]:
        asked.append((model, how))
        progress(0.5)
        return WHOLE | changes

    monkeypatch.setattr(soak, "bench_soak", measured)
    words = ["--model", "m", "--sessions", "3", "--minutes", "0.5", "--faults", "--picture", str(tmp_path / "a.png")]
    assert main(["bench", "soak", *words]) == code
    assert asked == [("m", {"sessions": 3, "visitors": 1, "minutes": 0.5, "faults": True})]
    told = capsys.readouterr().out.splitlines()
    assert json.loads(told[-1]) == WHOLE | changes
    assert ("did NOT stay whole" in told[-2]) == (code == 1)
    assert (tmp_path / "a.png").stat().st_size > 1_000


def test_its_help_says_what_a_soak_does_and_when_it_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "soak", "--help"])
    assert ended.value.code == 0
    told = capsys.readouterr().out
    for said in ("--faults", "--minutes", "Fails if something is"):
        assert said in " ".join(told.split())
