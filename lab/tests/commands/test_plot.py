import json
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar_lab.commands.plot import _names


def run(folder: Path) -> Path:
    folder.mkdir(parents=True)
    lines = [json.dumps({"step": n, "loss": 1 / n}) for n in range(1, 9)]
    (folder / "metrics.jsonl").write_text("\n".join(lines) + "\n")
    return folder


def test_two_runs_become_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [str(run(tmp_path / name / "generator")) for name in ("old", "new")]
    assert main(["plot", *folders, "-o", str(tmp_path / "c.png")]) == 0
    said = capsys.readouterr().out
    assert "old/generator: step 8, loss 0.125" in said
    assert (tmp_path / "c.png").exists()


def test_a_folder_without_a_run_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", str(tmp_path), "-o", str(tmp_path / "c.png")]) == 1
    assert "metrics.jsonl cannot be read" in capsys.readouterr().err


def test_runs_are_named_by_the_folders_that_differ() -> None:
    assert _names([Path("runs/a"), Path("runs/b")]) == ["a", "b"]
    assert _names([Path("x/a"), Path("y/a")]) == ["x/a", "y/a"]
    assert _names([Path("a"), Path("a")]) == ["a (1)", "a (2)"]
