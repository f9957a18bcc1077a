"""Split test is heard once for the same weights, and the card tells every reading."""

import json
import shutil
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.evaluation.test_split import READINGS, claim_test


def readings(folder: Path) -> list[dict[str, object]]:
    return json.loads((folder / "card.json").read_text())[READINGS]


def test_a_second_reading_needs_again_and_the_card_says_it(tmp_path: Path) -> None:
    (tmp_path / "card.json").write_text('{"licence": "CC0"}')
    (tmp_path / "model.safetensors").write_bytes(b"one")
    claim_test(tmp_path, command="c", commit="abc")
    with pytest.raises(EchoAvatarError, match=r"heard split test on 20.*commit abc.*--again"):
        claim_test(tmp_path, command="c", commit="def")
    assert len(readings(tmp_path)) == 1
    claim_test(tmp_path, command="c", commit="def", is_again=True)
    assert [(one["commit"], one.get("again")) for one in readings(tmp_path)] == [("abc", None), ("def", 1)]
    assert json.loads((tmp_path / "card.json").read_text())["licence"] == "CC0"
    (tmp_path / "model.safetensors").write_bytes(b"other weights")
    claim_test(tmp_path, command="c", commit="ghi")
    assert "again" not in readings(tmp_path)[-1]


def test_the_command_refuses_before_it_hears(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from echoavatar_lab.evaluation import domains

    heard: list[str] = []

    def read_sounds(folder: Path, seconds: float, most: int, *, split: str) -> list[object]:
        heard.append(split)
        raise EchoAvatarError("no sound; give some")

    monkeypatch.setattr(domains, "read_sounds", read_sounds)
    bundle = Path(shutil.copytree(tiny_bundle, tmp_path / "bundle"))
    words = ["evaluate", str(bundle), "domains", "--recordings", str(tmp_path), "--split", "test"]
    assert main(words) != 0
    assert "manifest.csv that marks files as test" in capsys.readouterr().err
    (tmp_path / "manifest.csv").write_text("path,kind\n")
    assert main(words) != 0
    assert heard == ["test"]
    assert main(words) != 0
    assert heard == ["test"]
    assert "--again" in capsys.readouterr().err
    assert main([*words, "--again"]) != 0
    assert heard == ["test", "test"]
    assert [one["command"] for one in readings(bundle / "generator")] == [
        f"echoavatar evaluate BUNDLE domains --recordings {tmp_path.name} --split test"
    ] * 2
