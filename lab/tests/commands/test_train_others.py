import argparse
import json
from importlib.resources import files
from pathlib import Path

import pytest
from lab.tests.evaluation.clips import clip, folder
from lab.tests.models.fingers.moving import waving
from tests.models.face.tiny import clip as face_clip

from echoavatar.cli import main
from echoavatar.models.face import FaceConfig
from echoavatar.motion.formats import write_bvh
from echoavatar.stored import read_card
from echoavatar_lab.commands import train
from echoavatar_lab.data import Clip, write_manifest
from echoavatar_lab.data.corpus import clip_path
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoderConfig
from echoavatar_lab.models.face.model import FaceModel
from echoavatar_lab.models.fingers.model import FingerConfig

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
    face_clip().save(folder / "a.npz")
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
    words = ["train", "face", str(faces(tmp_path / "faces")), "-o", str(tmp_path / "run")]
    assert main([*words, "--hubert", str(tmp_path / "none")]) == 1
    assert "neither a folder with a HuBERT model" in capsys.readouterr().err


SMALL = ["--steps", "3", "--batch", "2", "--width", "16", "--layers", "1"]


def corpus(folder: Path) -> Path:
    """Two clips of moving hands, one for testing."""
    import numpy as np

    for seed, split in ((0, "train"), (1, "test")):
        motion = waving(70, seed)
        clip = Clip(
            name=f"c{seed}",
            audio=np.zeros(70 * 800, np.float32),
            rotations=motion.rotations,
            root=motion.root,
            domain=np.zeros(70, np.uint8),
            split=split,
        )
        clip.save(clip_path(folder, clip.name))
    write_manifest(folder)
    return folder


def takes(folder: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    folder.mkdir()
    motion = waving(20)
    write_bvh(folder / "take.bvh", motion.skeleton, motion.rotations, motion.root, 30)
    return folder


def test_a_corpus_and_takes_train_a_model_with_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, more = corpus(tmp_path / "corpus"), takes(tmp_path / "takes", capsys)
    words = [str(source), "-o", str(tmp_path / "run"), "--recordings", str(more), *SMALL]
    assert main(["train", "fingers", *words]) == 0
    card = read_card(tmp_path / "run")
    assert str(card["command"]).startswith("echoavatar train fingers")
    assert "mean pose" in card["scores"]  # type: ignore[operator]
    assert card["step"] == 3


def test_a_folder_of_takes_will_do_and_an_empty_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = takes(tmp_path / "takes", capsys)
    assert main(["train", "fingers", str(more), "-o", str(tmp_path / "run"), *SMALL]) == 0
    (tmp_path / "empty").mkdir()
    assert main(["train", "fingers", str(tmp_path / "empty"), "-o", str(tmp_path / "x")]) == 1
    assert "neither a corpus nor .bvh files" in capsys.readouterr().err


SMALL_ENCODER = ["--steps", "4", "--width", "8", "--latent", "4"]


def test_a_corpus_trains_an_extractor_that_score_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corpus = folder(
        tmp_path / "corpus", [clip("a", 100, split="train"), clip("b", 100), clip("c", 120)], is_corpus=True
    )
    run = tmp_path / "run"
    assert main(["train", "fid-encoder", str(corpus), "-o", str(run), *SMALL_ENCODER]) == 0
    card = read_card(run)
    assert str(card["command"]).startswith("echoavatar train fid-encoder")
    assert card["step"] == 4
    assert {"explained_train", "explained_test"} == set(card["scores"])  # type: ignore[call-overload]
    assert (
        main(["train", "fid-encoder", str(corpus), "-o", str(run), *SMALL_ENCODER]) == 0
    )  # done already: nothing to do
    capsys.readouterr()
    words = ["score", str(corpus), str(corpus), "--no-audio", "--extractor", str(run), "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["fid"]["value"] == pytest.approx(0, abs=1e-6)


def test_a_corpus_without_training_clips_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    corpus = folder(tmp_path / "corpus", [clip("b", 100)], is_corpus=True)
    assert main(["train", "fid-encoder", str(corpus), "-o", str(tmp_path / "run"), *SMALL_ENCODER]) == 1
    assert "no training clips" in capsys.readouterr().err


def test_defaults_are_the_sizes_of_the_shipped_models() -> None:
    for kind, config, shipped in (
        ("face", FaceConfig, files("echoavatar") / "bundles/default/face"),
        ("fingers", FingerConfig, files("echoavatar_lab") / "bundles/fingers"),
        ("fid-encoder", MotionEncoderConfig, files("echoavatar_lab") / "bundles/fid_encoder"),
    ):
        parser = argparse.ArgumentParser()
        train.add_arguments(parser)
        args = parser.parse_args([kind, "source", "-o", "out"])
        wanted = config.model_validate_json((shipped / "config.json").read_text())
        assert args.options.settings(args).checked(config, "model") == wanted
