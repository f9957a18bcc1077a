import argparse
from pathlib import Path

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.models.fingers import FingerConfig
from echoavatar_lab.commands.recipe import Options, read_recipe
from echoavatar_lab.models.fingers import FingerTraining


def parsed(*words: str):
    parser = argparse.ArgumentParser()
    options = Options(parser)
    options.add("--steps", "training.steps", 3000, type=int, help="steps")
    options.add("--width", "model.width", None, type=int, help="channels")
    options.add("--no-mirror", "training.is_mirrored", True, action="store_true", help="not mirrored")
    return options, parser.parse_args(words)


def written(folder: Path, text: str) -> str:
    (folder / "r.yaml").write_text(text)
    return str(folder / "r.yaml")


def test_the_command_line_wins_over_the_recipe_and_that_over_the_default(tmp_path: Path) -> None:
    recipe = written(tmp_path, "training: {steps: 7, losses: {a: 1}}\nmodel: {width: 8}\n")
    base = {"training": {"losses": {"a": 0, "b": 2}, "batch": 4}}
    options, args = parsed("--recipe", recipe, "--width", "16", "--no-mirror")
    settings = options.settings(args, base)
    assert settings.model == {"width": 16}
    assert settings.training == {"losses": {"a": 1, "b": 2}, "batch": 4, "steps": 7, "is_mirrored": False}
    options, args = parsed()
    settings = options.settings(args, base)
    assert settings.training["steps"] == 3000
    assert settings.training["is_mirrored"]
    assert settings.model == {}
    assert base == {"training": {"losses": {"a": 0, "b": 2}, "batch": 4}}


def test_unknown_keys_and_values_that_do_not_fit_are_refused_by_name(tmp_path: Path) -> None:
    options, args = parsed("--recipe", written(tmp_path, "training: {learning_rat: 1}\nmodel: {widht: 8}\n"))
    settings = options.settings(args)
    with pytest.raises(EchoAvatarError, match=r"r.yaml: model.widht is not a setting.*did you mean width\?"):
        settings.checked(FingerConfig, "model")
    settings.training.pop("is_mirrored")
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
    with pytest.raises(EchoAvatarError, match="cannot read the recipe"):
        read_recipe(tmp_path / "none.yaml")
    assert read_recipe(Path(written(tmp_path, "# nothing\n"))) == {}
