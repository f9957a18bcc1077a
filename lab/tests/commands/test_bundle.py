import json
from pathlib import Path

import pytest

from echoavatar.cli import main


def test_parts_become_a_bundle_that_loads(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bundle", str(tiny_bundle), "-o", str(tmp_path / "mine"), "--no-graphs"]) == 0
    assert main(["bundle", str(tmp_path / "mine")]) == 0
    assert "52 joints" in capsys.readouterr().out
    assert json.loads((tmp_path / "mine" / "card.json").read_text())["licence"] == "Apache-2.0"


def test_int8_is_smaller_and_loads(tiny_bundle: Path, tmp_path: Path) -> None:
    size = {}
    for option in ([], ["--int8"]):
        folder = tmp_path / "-".join(["mine", *option])
        assert main(["bundle", str(tiny_bundle), "-o", str(folder), "--no-graphs", *option]) == 0
        size[len(option)] = (folder / "generator/model.safetensors").stat().st_size
    assert size[1] < 0.8 * size[0]


def test_an_untrained_part_is_named(tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bundle", str(tiny_bundle.parent), "-o", str(tmp_path / "mine")]) == 1
    assert "train it first" in capsys.readouterr().err
