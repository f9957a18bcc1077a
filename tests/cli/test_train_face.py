from pathlib import Path

import pytest
from tests.models.face.tiny import clip

from echoavatar.checkpoint import read_card
from echoavatar.cli import main
from echoavatar.models.face import FaceModel

RECIPE = """
model:
  encoder: {kind: mel, bands: 8, windows: 2, width: 8, blocks: 1}
  width: 16
  layers: 1
  heads: 2
  condition: 8
  head_width: 16
  head_blocks: 1
training: {steps: 3, batch: 2, frames: 16}
"""


def faces(folder: Path) -> Path:
    folder.mkdir()
    clip().save(folder / "a.npz")
    return folder


def test_a_recipe_and_options_over_it_train_a_face(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(RECIPE)
    words = ["train", "face", str(faces(tmp_path / "faces")), "-o", str(tmp_path / "run")]
    assert main([*words, "--recipe", str(tmp_path / "r.yaml"), "--steps", "2", "--no-tempo"]) == 0
    assert FaceModel.load(tmp_path / "run").config.width == 16
    training = read_card(tmp_path / "run")["training"]
    assert (training["steps"], training["tempo"], training["batch"]) == (2, False, 2)  # type: ignore[index]


def test_a_key_that_no_face_has_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "r.yaml").write_text("training: {stepps: 3}\n")
    words = ["train", "face", str(faces(tmp_path / "faces")), "-o", str(tmp_path / "run")]
    assert main([*words, "--recipe", str(tmp_path / "r.yaml")]) == 1
    assert "training.stepps is not a setting of this stage; did you mean steps?" in capsys.readouterr().err
