import json
import shutil
from pathlib import Path

import pytest

from echoavatar.cli import main


@pytest.fixture(scope="module")
def mine(tiny_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles") / "mine"
    assert main(["bundle", str(tiny_bundle), "-o", str(folder), "--no-graphs"]) == 0
    return folder


def test_parts_become_a_bundle_that_loads(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bundle", str(mine)]) == 0
    assert "52 joints" in capsys.readouterr().out
    assert json.loads((mine / "card.json").read_text())["licence"] == "Apache-2.0"


def test_int8_is_smaller_and_loads(mine: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "int8").mkdir()
    shutil.copy(mine / "actions.json", tmp_path / "int8")
    assert main(["bundle", str(tiny_bundle), "-o", str(tmp_path / "int8"), "--no-graphs", "--int8"]) == 0
    whole, small = ((folder / "generator/model.safetensors").stat().st_size for folder in (mine, tmp_path / "int8"))
    assert small < 0.8 * whole


def test_an_untrained_part_is_named(tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bundle", str(tiny_bundle.parent), "-o", str(tmp_path / "mine")]) == 1
    assert "train it first" in capsys.readouterr().err
