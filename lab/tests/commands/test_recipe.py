import argparse
import os
from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field

from echoavatar.errors import EchoAvatarError
from echoavatar_lab import paper
from echoavatar_lab.commands.recipe import Options, paper_recipe, read_recipe
from echoavatar_lab.models.fingers.model import FingerConfig
from echoavatar_lab.models.fingers.train import FingerTraining
from echoavatar_lab.training import TrainingConfig

BASE = {"training": {"losses": {"a": 0, "b": 2}, "batch": 4, "steps": 3000}}


class Schedule(TrainingConfig):
    optimiser: Literal["adamw", "muon"] = Field(default="adamw", description="which")
    is_mirrored: bool = Field(default=True, description="also 100 % mirrored")


def parsed(*words: str):
    parser = argparse.ArgumentParser()
    options = Options(parser, model=FingerConfig, training=Schedule, base=BASE)
    options.add("--steps", "training.steps")
    options.add("--width", "model.width")
    options.add("--no-mirror", "training.is_mirrored")
    options.add("--optimiser", "training.optimiser")
    return options, parser.parse_args(words)


def written(folder: Path, text: str) -> str:
    (folder / "r.yaml").write_text(text)
    return str(folder / "r.yaml")


def test_the_command_line_wins_over_the_recipe_and_that_over_the_default(tmp_path: Path) -> None:
    recipe = written(tmp_path, "training: {steps: 7, losses: {a: 1}}\nmodel: {width: 8}\n")
    options, args = parsed("--recipe", recipe, "--width", "16", "--no-mirror")
    settings = options.settings(args)
    assert settings.model == {"width": 16}
    assert settings.training == {"losses": {"a": 1, "b": 2}, "batch": 4, "steps": 7, "is_mirrored": False}
    options, args = parsed()
    settings = options.settings(args)
    assert settings.training == {"losses": {"a": 0, "b": 2}, "batch": 4, "steps": 3000}
    assert settings.model == {}


def test_an_option_has_the_type_the_text_and_the_default_of_its_field(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    options = Options(parser, training=Schedule, base=BASE)
    for name in ("steps", "optimiser", "is_mirrored"):
        options.add(f"--{name}", f"training.{name}")
    told = " ".join(parser.format_help().split())
    assert "optimiser steps of the whole schedule (default: 3000)" in told
    assert "turn off: also 100 % mirrored" in told
    with pytest.raises(SystemExit):
        parser.parse_args(["--optimiser", "sgd"])
    assert "invalid choice: 'sgd'" in capsys.readouterr().err


def test_unknown_keys_and_values_that_do_not_fit_are_refused_by_name(tmp_path: Path) -> None:
    options, args = parsed("--recipe", written(tmp_path, "training: {learning_rat: 1}\nmodel: {widht: 8}\n"))
    settings = options.settings(args)
    with pytest.raises(EchoAvatarError, match=r"r.yaml: model.widht is not a setting.*did you mean width\?"):
        settings.checked(FingerConfig, "model")
    settings.training.pop("losses")
    with pytest.raises(EchoAvatarError, match="training.learning_rat .*learning_rate"):
        settings.checked(FingerTraining, "training")
    options, args = parsed("--recipe", written(tmp_path, "model: {width: wide}\n"))
    with pytest.raises(EchoAvatarError, match=r"model.width: Input should be a valid integer"):
        options.settings(args).checked(FingerConfig, "model")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("modle: {}\n", "unknown section modle; there are model and training"),
        ("- a\n- b\n", "has the sections"),
        ("training: 3\n", "has the sections"),
        ("a: [", "is not YAML"),
        ("a: !!python/object/apply:os.getcwd []\n", "is not YAML"),
    ],
)
def test_invalid_recipes_are_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(EchoAvatarError, match=said):
        read_recipe(Path(written(tmp_path, text)))


def test_a_missing_recipe_is_named_and_an_empty_one_changes_nothing(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="cannot be read"):
        read_recipe(tmp_path / "none.yaml")
    assert read_recipe(Path(written(tmp_path, "# nothing\n"))) == {}


@pytest.mark.parametrize(
    "text",
    [
        "model: &a {width: *a}\n",
        "[" * 60_000,
        "- " * 30_000,
        "training: {steps: 2020-99-99}\n",
        f"training: {{steps: {'9' * 5_000}}}\n",
        "#" * 70_000,
    ],
)
def test_a_hostile_recipe_is_one_error(tmp_path: Path, text: str) -> None:
    with pytest.raises(EchoAvatarError):
        read_recipe(Path(written(tmp_path, text)))


def test_a_recipe_that_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(EchoAvatarError, match="not a regular file"):
        read_recipe(tmp_path / "pipe")


def test_a_recipe_of_the_paper_changes_its_settings_and_no_others(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text("paper: tokens\ntraining:\n  is_mirrored: true\n")
    found = paper_recipe(read_recipe(path), path)
    assert found == {"model": {}, "training": {"patience": 0, "is_leveled": False, "is_mirrored": True}}
    assert not paper.TOKENS["training"]["is_mirrored"]  # it is a copy that changes
    path.write_text("paper: lips\n")
    with pytest.raises(EchoAvatarError, match="no paper: lips; there are codec, tokenizer"):
        paper_recipe(read_recipe(path), path)
