"""Every recipe opens with commands that run it, and says only what its stage knows; the tiny ones really run."""

import argparse
import json
import re
import shlex
from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.config import Config
from echoavatar.models.audio import CodecConfig
from echoavatar.models.face import FaceConfig
from echoavatar.models.generator import GeneratorConfig
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.commands import train
from echoavatar_lab.commands.train_body import body_sizes, complete
from echoavatar_lab.evaluation.metrics.motion_encoder import MotionEncoderConfig
from echoavatar_lab.evaluation.metrics.motion_encoder_train import MotionEncoderTraining
from echoavatar_lab.models.audio.train import CodecTrainingConfig
from echoavatar_lab.models.face.train import FaceTraining
from echoavatar_lab.models.fingers.model import FingerConfig
from echoavatar_lab.models.fingers.train import FingerTraining
from echoavatar_lab.models.generator.train import GeneratorTraining
from echoavatar_lab.models.tokenize import TokenSettings
from echoavatar_lab.models.tokenizer.decoder_train import DecoderTraining
from echoavatar_lab.models.tokenizer.train import TokenizerTraining

ROOT = Path(__file__).parents[3]
RECIPES = sorted((ROOT / "lab/recipes").glob("*/*.yaml"))
CONFIGS = {
    "codec": (CodecConfig, CodecTrainingConfig),
    "tokenizer": (None, TokenizerTraining),
    "tokens": (Config, TokenSettings),
    "decoder": (None, DecoderTraining),
    "generator": (GeneratorConfig, GeneratorTraining),
    "face": (FaceConfig, FaceTraining),
    "fingers": (FingerConfig, FingerTraining),
    "fid-encoder": (MotionEncoderConfig, MotionEncoderTraining),
}


def commands(path: Path) -> list[list[str]]:
    """The words after `echoavatar` of the commands that a recipe opens with."""
    found = []
    for line in path.read_text().splitlines():
        if not line.startswith(("# echoavatar ", "# accelerate ")):
            break
        words = shlex.split(line[1:])
        found.append(words[words.index("echoavatar") + 1 :])
    return found


def settings_of(words: list[str]):
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)
    args = parser.parse_args(words[1:])
    settings = args.options.settings(args)
    if args.kind == "generator":
        complete(settings, motion_layers=len(settings.training.get("depth_weights", [1])))
    return args.kind, settings


def test_there_is_one_for_every_stage_at_every_scale() -> None:
    stages = {"codec", "tokenizer", "tokens", "face", "fid_encoder", *(f"generator_stage{n}" for n in (1, 2, 3))}
    for scale in ("paper", "rehearsal", "tiny"):
        assert {path.stem for path in RECIPES if path.parent.name == scale} >= stages


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_a_recipe_opens_with_its_commands_and_has_valid_settings(path: Path, monkeypatch) -> None:
    monkeypatch.chdir(ROOT)
    assert commands(path)
    for words in commands(path):
        assert words[:1] == ["train"]
        assert words[words.index("--recipe") + 1] == str(path.relative_to(ROOT))
        kind, settings = settings_of(words)
        runs = "_(stage.*|offline|depth|speakers|manner|hands|heights|mirrored)$"
        assert kind.replace("-", "_") == re.sub(runs, "", path.stem)
        model, training = CONFIGS[kind]
        settings.checked(training, "training")
        if model is None:
            assert set(body_sizes(settings, HUMANOID).parts) == {"lower", "upper", "hands"}
        else:
            settings.checked(model, "model")


def test_the_rehearsal_recipes_are_those_of_the_shipped_models(monkeypatch) -> None:
    """Every setting that a shipped card tells of its last run is what the recipe's last command says."""
    monkeypatch.chdir(ROOT)
    bundles = ROOT / "src" / "echoavatar" / "bundles"
    cards = {
        "tokenizer": bundles / "default" / "tokenizer",
        "decoder": bundles / "default" / "tokenizer",  # a run of its own, told under its name
        "generator_depth": bundles / "default" / "generator",  # this and the next three: told under their names
        "generator_speakers": bundles / "default" / "generator",
        "generator_manner": bundles / "default" / "generator",
        "generator_hands": bundles / "default" / "generator",
        "generator_heights": bundles / "default" / "generator",
        "face": bundles / "default" / "face",
        "codec": bundles / "default" / "codec",
        "fingers": ROOT / "lab/src/echoavatar_lab/bundles/fingers",
        "fid_encoder": ROOT / "lab/src/echoavatar_lab/bundles/fid_encoder",
    }
    two_runs = {  # or three; the recipe is that of the first
        "tokenizer": {"steps", "learning_rate", "warmup", "decay_at", "quantize_from", "is_principal_start"},
        "decoder": {"steps", "learning_rate", "warmup"},
        "generator_depth": {
            "steps",
            "minutes",
            "batch",
            "learning_rate",
            "seed",
            "warmup",
            "average",
            "asked",
            "out_of_step",
        },
    }
    other = {"face": "listening_rate", "generator_depth": "audio_dropout"}  # the latter is no setting any more
    renamed = {"gradient_norm": "clip", "checkpoint_minutes": "save_minutes", "noise": "noise_spread"}
    for stem, folder in cards.items():
        kind, settings = settings_of(commands(ROOT / "lab/recipes" / "rehearsal" / f"{stem}.yaml")[-1])
        ours = settings.checked(CONFIGS[kind][1], "training").model_dump(mode="json")
        card = json.loads((folder / "card.json").read_text())
        theirs = card.get(stem, card)["training"]
        for key, value in theirs.items():
            if key in ("evaluate_every", "save_every", "save_minutes", "log_every") or key == other.get(stem):
                continue
            if key in two_runs.get(stem, ()):
                continue
            expected = [round(v, 4) for v in value] if key == "depth_weights" else value
            assert ours[renamed.get(key, key)] == expected, f"{stem}: {key}"


@pytest.mark.slow
def test_the_tiny_recipes_run_from_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands as they stand in the files, in order, in an empty folder; then a picture of what they told."""
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab/recipes").symlink_to(ROOT / "lab/recipes")
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split("data rehearse --hours 0.07 --seed 1 -o corpus --workers 1")) == 0
    assert main(shlex.split("data face --rehearse 0.01 --seed 1 -o faces")) == 0
    trained = []

    def go(stem: str) -> None:
        for words in commands(ROOT / "lab/recipes" / "tiny" / f"{stem}.yaml"):
            assert main(words) == 0, words
            trained.append(words[words.index("-o") + 1])

    for stem in ("codec", "tokenizer"):
        go(stem)
    for words in commands(ROOT / "lab/recipes/tiny/tokens.yaml"):
        assert main(words) == 0, words
    for stem in (
        "generator_stage1",
        "generator_stage2",
        "generator_stage3",
        "generator_stage3_prompt",
        "generator_offline",
        "generator_depth",
        "face",
        "fingers",
        "fid_encoder",
    ):
        go(stem)
    for folder in trained:
        last = json.loads((Path(folder) / "metrics.jsonl").read_text().splitlines()[-1])
        assert last["step"] in (10, 20), folder
    assert main(["plot", *trained, "-o", "curves.png"]) == 0
    assert Path("curves.png").stat().st_size > 20_000
