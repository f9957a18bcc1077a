from pathlib import Path

import pytest
from tests.models.warp.tiny import clicks

from echoavatar.checkpoint import read_card
from echoavatar.cli import main
from echoavatar.data.corpus import ClipEntry, Manifest
from echoavatar.models.warp import WarpModel

RECIPE = """
model: {encoder: {kind: mel, bands: 8, windows: 2, width: 8, blocks: 1, past: 2}}
training: {steps: 5, batch: 2, frames: 16}
"""


def corpus(folder: Path) -> Path:
    folder.mkdir()
    clip = clicks()
    path = folder / "clips" / f"{clip.name}.npz"
    path.parent.mkdir()
    clip.save(path)
    entry = ClipEntry(name=clip.name, split="train", frames=clip.frames, domains={"silence": clip.frames})
    (folder / "manifest.json").write_text(Manifest(clips=(entry,)).model_dump_json())
    return folder


def test_a_recipe_and_options_over_it_train_a_pulse(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(RECIPE)
    words = ["train", "warp", str(corpus(tmp_path / "corpus")), "-o", str(tmp_path / "run")]
    assert main([*words, "--recipe", str(tmp_path / "r.yaml"), "--steps", "2"]) == 0
    assert WarpModel.load(tmp_path / "run").config.encoder.width == 8  # type: ignore[union-attr]
    card = read_card(tmp_path / "run")
    assert (card["kind"], card["training"]["steps"]) == ("warp", 2)  # type: ignore[index]


def test_a_folder_without_a_manifest_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["train", "warp", str(tmp_path / "empty"), "-o", str(tmp_path / "run")]) == 1
    assert "manifest.json is missing" in capsys.readouterr().err
