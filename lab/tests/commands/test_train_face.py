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


def test_a_pretrained_hubert_is_the_ear_and_stays_as_it_is(tmp_path: Path) -> None:
    """A tiny random one, saved as transformers saves the published ones (paper: multilingual, 768 channels)."""
    transformers = pytest.importorskip("transformers")
    config = transformers.HubertConfig(
        hidden_size=16, num_hidden_layers=1, num_attention_heads=2, intermediate_size=16, conv_dim=[4] * 7,
        num_conv_pos_embeddings=4, num_conv_pos_embedding_groups=2,
    )  # fmt: skip
    theirs = transformers.HubertModel(config)
    theirs.save_pretrained(tmp_path / "hubert")
    (tmp_path / "r.yaml").write_text(RECIPE.replace("{steps: 3,", "{steps: 1,"))
    words = ["train", "face", str(faces(tmp_path / "faces")), "-o", str(tmp_path / "run"), "--no-tempo"]
    assert main([*words, "--recipe", str(tmp_path / "r.yaml"), "--hubert", str(tmp_path / "hubert")]) == 0
    face = FaceModel.load(tmp_path / "run")
    assert (face.config.encoder.kind, face.config.encoder.width) == ("hubert", 16)
    kept, given = face.encoder.hubert.state_dict(), theirs.state_dict()
    assert all((kept[name] == value).all() for name, value in given.items())


def test_a_folder_without_hubert_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("transformers")
    words = ["train", "face", str(faces(tmp_path / "faces")), "-o", str(tmp_path / "run"), "--paper"]
    assert main([*words, "--hubert", str(tmp_path / "none")]) == 1
    assert "neither a folder with a HuBERT model" in capsys.readouterr().err
