"""`align compare` measures what is given and writes what it prints."""

import json
import shutil
from pathlib import Path

from lab.tests.align.moving_bodies import reference_statistics
from lab.tests.align.tuning_fakes import save_clips

from echoavatar.cli import main
from echoavatar_lab.align.compare import compare


def test_generators_side_by_side(tmp_path: Path, tiny_bundle: Path, capsys, monkeypatch) -> None:
    folder = save_clips(tmp_path / "tokens", 3, 8, held_out=True)
    reference_statistics().save(tmp_path / "reference_statistics.json")
    words = ["--model", str(tiny_bundle), "--reference-statistics", str(tmp_path / "reference_statistics.json")]
    words += ["--reward", "smoothness=1", "--prompts", "2", "--group", "2", "--past", "2", "--length", "4"]
    again = tmp_path / "again"
    shutil.copytree(tiny_bundle / "generator", again)
    both = [str(tiny_bundle / "generator"), str(again)]
    words += ["--beside", *both, "--device", "cpu", "-o", str(tmp_path / "found.json")]
    asked = []
    monkeypatch.setattr("echoavatar_lab.align.compare.compare", lambda *a, **b: asked.append(b) or compare(*a, **b))
    assert main(["align", "compare", str(folder), *words]) == 0
    told = json.loads((tmp_path / "found.json").read_text())
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == told
    assert list(told["found"]) == ["truth", "untuned", *both]
    assert told["over_seeds"][", ".join(both)]["gain"] == [0.0, 0.0, 0.0]
    assert asked[0]["device"] == "cpu"
    assert len((tmp_path / "found.md").read_text().splitlines()) == 5
    assert told["prompts"] == 2
