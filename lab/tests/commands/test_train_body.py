"""The command from a corpus on disk: a recipe's settings reach the run, and codes keep their meaning."""

import argparse
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import torch
from lab.tests.commands.test_train_others import corpus
from lab.tests.models.generator.test_train import clips
from tests.models.motion_tokens import dance, small_body
from transformers import EncodecConfig, EncodecModel

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError
from echoavatar.models.audio import CodecConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar.stored import read_card
from echoavatar_lab.commands import train
from echoavatar_lab.commands.recipe import Settings, shipped
from echoavatar_lab.commands.train_body import body_sizes, complete
from echoavatar_lab.data import Clip
from echoavatar_lab.data.corpus import clip_path, write_manifest
from echoavatar_lab.models.audio.codec import AudioCodec
from echoavatar_lab.models.generator.model import Generator
from echoavatar_lab.models.published import read_encodec
from echoavatar_lab.models.tokenizer.model import BodyTokenizer
from echoavatar_lab.training.run import Signals

RECIPE = """
model: {filters: 2, width: 8, codes: 16, lstm_layers: 1}
training: {minutes: 0, steps: 3, batch: 2, decoded: 1, crop_frames: 10, unquantized: 9, log_every: 1}
"""


def test_a_recipe_makes_it_small_and_the_card_says_what_was_given(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text(RECIPE)
    source = corpus(tmp_path / "corpus")
    words = ["train", "codec", str(source), "-o", str(tmp_path / "run"), "--recipe", str(tmp_path / "r.yaml")]
    assert main(words) == 0
    card = read_card(tmp_path / "run")
    assert card["steps_done"] == 3
    assert card["command"] == f"echoavatar train codec {source} -o {tmp_path}/run --recipe {tmp_path}/r.yaml"


def test_a_set_without_sound_is_told_at_once_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = corpus(tmp_path / "quiet")
    told = (source / "manifest.json").read_text().replace('"frames": 70', '"has_sound": false, "frames": 70')
    assert "has_sound" in told
    (source / "manifest.json").write_text(told)
    assert main(["train", "codec", str(source), "-o", str(tmp_path / "run")]) == 1
    assert f"no training clip of {source} has sound" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_published_encodec_is_taken_by_one_command(tmp_path: Path) -> None:
    torch.manual_seed(0)
    sizes = {"num_filters": 2, "hidden_size": 16, "codebook_size": 64, "target_bandwidths": [0.9]}
    EncodecModel(EncodecConfig(**sizes)).save_pretrained(tmp_path / "theirs")
    made, source = tmp_path / "codec", str(tmp_path)
    assert main(["train", "codec", source, "-o", str(made), "--from", str(tmp_path / "theirs")]) == 0
    taken = AudioCodec.load(made)
    sound = torch.randn(1, 6400)
    assert torch.equal(taken.encode(sound), read_encodec(tmp_path / "theirs").encode(sound))


def stage_settings(kind: str, *words: str) -> Settings:
    """The settings of a stage's command."""
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    parts = ["--codec", "c", "--tokenizer", "t"] if kind in ("tokens", "generator") else []
    parts += ["--tokenizer", "t"] if kind == "decoder" else []
    args = parser.parse_args([kind, "source", "-o", "out", *parts, *words])
    return args.options.settings(args)


def settings(model: dict[str, object]) -> Settings:
    return stage_settings("tokenizer")._replace(model={"width": 32, "heads": 2, "lookback": 15} | model)


def test_a_part_can_override_common_sizes() -> None:
    found = body_sizes(settings({"parts": {"hands": {"lookback": 7}}}), HUMANOID).parts
    assert {name: part.lookback for name, part in found.items()} == {"lower": 15, "upper": 15, "hands": 7}
    assert {part.width for part in found.values()} == {32}


def test_unknown_parts_and_unshared_widths_are_refused() -> None:
    with pytest.raises(EchoAvatarError, match="model.parts.tail is no part of the body; there are lower"):
        body_sizes(settings({"parts": {"tail": {}}}), HUMANOID)
    with pytest.raises(EchoAvatarError, match="may not differ in width"):
        body_sizes(settings({"parts": {"hands": {"width": 16}}}), HUMANOID)


def test_a_body_may_be_one_part() -> None:
    found = body_sizes(settings({"is_whole": True, "blocks": "convolution"}), HUMANOID)
    assert {name: (part.features, part.blocks) for name, part in found.parts.items()} == {"body": (315, "convolution")}


DECODER_RECIPE = "training: {batch: 2, tokens: 8, unheard: 1, log_every: 1}\n"


def test_a_tokenizer_comes_out_whose_codes_are_the_old_ones(tmp_path, capsys):
    for seed in range(3):
        body = dance(seed, 64)
        sound, domain = np.zeros(64 * 800, np.float32), np.zeros(64, np.uint8)
        split = "test" if seed == 2 else "train"
        clip = Clip(f"clip{seed}", sound, body.rotations, body.root, domain, split=split)
        path = clip_path(tmp_path / "corpus", clip.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        clip.save(path)
    write_manifest(tmp_path / "corpus")
    start = small_body()
    start.save(tmp_path / "tokenizer", {}, dtype=torch.float32)
    (tmp_path / "recipe.yaml").write_text(DECODER_RECIPE)
    given = ["train", "decoder", tmp_path / "corpus", "-o", tmp_path / "out", "--steps", 2]
    given += ["--tokenizer", tmp_path / "tokenizer", "--recipe", tmp_path / "recipe.yaml"]
    assert main([str(word) for word in given]) == 0
    after = BodyTokenizer.load(tmp_path / "out")
    assert torch.allclose(after.codebooks(), start.codebooks(), atol=1e-2)
    card = read_card(tmp_path / "out")
    assert card["training"]["tokens"] == 8
    assert card["step"] == 2
    assert card["licence"] == "Apache-2.0"
    assert "--tokenizer" in card["command"]
    assert card["scores"]["mpjpe_body_mm"] > 0


GENERATOR_RECIPE = "model: {width: 16, layers: 1, window_chunks: 3}\ntraining: {steps: 4, batch: 2, warmup: 1}\n"


@pytest.fixture
def words(tiny_bundle: Path, tmp_path: Path) -> list[str]:
    """A command that trains a generator of the tiny bundle's layout in moments."""
    (tmp_path / "tokens").mkdir()
    for at, clip in enumerate(clips()):
        clip.save(tmp_path / "tokens" / f"{at}.npz")
    (tmp_path / "r.yaml").write_text(GENERATOR_RECIPE)
    parts = ["--codec", str(tiny_bundle / "codec"), "--tokenizer", str(tiny_bundle / "tokenizer")]
    return ["train", "generator", str(tmp_path / "tokens"), "--recipe", str(tmp_path / "r.yaml"), *parts]


def test_stages_follow_each_other(words: list[str], tmp_path: Path) -> None:
    """The third stage takes sets, and begins with what the second left; sizes and layers follow from the parts."""
    assert main([*words, "-o", str(tmp_path / "a")]) == 0
    assert main([*words, "-o", str(tmp_path / "b"), "--start", str(tmp_path / "a"), "--exemplar", "0.5"]) == 0
    model = Generator.load(tmp_path / "b")
    assert (model.config.width, model.config.mlp, model.config.exemplar) == (16, 48, True)
    training = read_card(tmp_path / "b")["training"]
    assert (training["chunks"], training["depth_weights"]) == (9, [1.0, 0.7])  # type: ignore[index]
    assert training["optimiser"] == "muon"  # type: ignore[index]


def test_a_run_that_is_ended_says_how_far_it_is_and_how_to_go_on(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    entered = Signals.__enter__

    def enter(signals: Signals) -> Signals:
        found = entered(signals)
        os.kill(os.getpid(), signal.SIGTERM)
        return found

    with monkeypatch.context() as patched:
        patched.setattr(Signals, "__enter__", enter)
        assert main([*words, "-o", str(tmp_path / "run")]) == 143
    assert "stopped at step 0 of 4" in capsys.readouterr().err
    assert main([*words, "-o", str(tmp_path / "run")]) == 0
    assert read_card(tmp_path / "run")["step"] == 4


def test_defaults_are_the_sizes_of_the_shipped_bundle() -> None:
    codec = stage_settings("codec").checked(CodecConfig, "model")
    assert codec.model_dump(mode="json") == shipped("codec")
    tokenizer = body_sizes(stage_settings("tokenizer"), HUMANOID)
    assert tokenizer.model_dump(mode="json")["parts"] == shipped("tokenizer")["parts"]
    found = stage_settings("generator")
    complete(found, tokenizer.layers)
    heard = {name: shipped("generator")[name] for name in ("layout", "patience")}
    generator = found.checked(GeneratorConfig, "model", **heard)
    # Neither is a size: clips have manners where the corpus was made with them, and the chunk goes with the face.
    told = {"manner": False, "step": 2}
    assert generator == GeneratorConfig.model_validate(shipped("generator") | told)
    assert stage_settings("tokens").training["patience"] == stage_settings("decoder").training["patience"]
    assert stage_settings("tokens").training["patience"] == generator.patience


def test_another_width_has_heads_and_an_mlp_that_fit_it() -> None:
    found = stage_settings("generator", "--width", "32")
    complete(found, 2)
    config = found.checked(GeneratorConfig, "model")
    assert (config.width, config.heads, config.mlp, config.sequence) == (32, 4, 96, "depth")
