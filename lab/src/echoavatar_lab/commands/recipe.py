"""Stages of training, their options, and recipes: the settings of a stage in a YAML file.

    training:
      learning_rate: 2.0e-4
    model:
      width: 256

Options on the command line win over the recipe, which wins over the stage's defaults. Unknown keys are errors. With
`paper: NAME` the recipe changes the paper's settings of that name (`echoavatar_lab.paper`), not the stage's defaults.
"""

import argparse
import copy
import difflib
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_object
from echoavatar.limits import read_text
from echoavatar.yaml_reader import YAML_BYTES, read_yaml
from echoavatar_lab import paper

from .config_options import add_field

SECTIONS, PAPER = ("model", "training"), "paper"
ConfigT = TypeVar("ConfigT", bound=Config)


class Options:
    """The options of a sub-command that set fields of its configs; type, choices, help and default are the field's."""

    def __init__(
        self,
        parser: argparse.ArgumentParser,
        *,
        model: type[Config] = Config,
        training: type[Config] = Config,
        base: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """`base` holds defaults, by section, that replace those of the configs."""
        self._parser, self._fields = parser, dict[str, tuple[str, str]]()
        self._configs = {"model": model, "training": training}
        self._base = {section: dict((base or {}).get(section, {})) for section in SECTIONS}
        parser.add_argument("--recipe", type=Path, metavar="YAML", help="file of settings; options win over it")
        parser.set_defaults(options=self)

    def add(self, flag: str, field: str) -> None:
        """Declare an option for `section.name`; of a field that is on by default, one that turns it off."""
        section, name = field.split(".")
        default = self._base[section].get(name)
        action = add_field(self._parser, flag, self._configs[section], name, default=default)
        self._fields[action.dest] = section, name

    def settings(self, args: argparse.Namespace) -> "Settings":
        """Merge the settings; priority: command line, recipe, defaults."""
        values = copy.deepcopy(self._base)
        recipe = read_recipe(args.recipe) if args.recipe else {}
        if PAPER in recipe:
            values = {section: {} for section in SECTIONS}
            recipe = paper_recipe(recipe, args.recipe)
        for section, found in recipe.items():
            _merge(values[section], found)
        named = {(section, name) for section, found in recipe.items() for name in found}
        for dest, (section, name) in self._fields.items():
            if (given := getattr(args, dest)) is not None:
                values[section][name] = given
                named.add((section, name))
        return Settings(values["model"], values["training"], named, str(args.recipe or "the command line"))


class Settings(NamedTuple):
    """The merged settings of a stage, not validated yet."""

    model: dict[str, Any]
    training: dict[str, Any]
    named: set[tuple[str, str]]  # (section, key) given on the command line or in the recipe
    origin: str

    def names(self, key: str) -> bool:
        """Whether the user chose `section.key`."""
        section, name = key.split(".")
        return (section, name) in self.named

    def checked(self, kind: type[ConfigT], section: str, **more: Any) -> ConfigT:
        """A section as a validated config.

        Raises EchoAvatarError if a key is unknown, or a value is invalid; names both.
        """
        values = {**getattr(self, section), **more}
        try:
            return kind.model_validate(values)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in (section, *first["loc"]))
            if first["type"] == "extra_forbidden":
                near = difflib.get_close_matches(str(first["loc"][-1]), list(kind.model_fields), 1)
                meant = f"; did you mean {near[0]}?" if near else ""
                raise EchoAvatarError(f"{self.origin}: {place} is not a setting of this stage{meant}") from error
            raise EchoAvatarError(f"{self.origin}: {place}: {first['msg']}") from error


class Given(NamedTuple):
    """What a stage is trained with."""

    args: argparse.Namespace
    settings: Settings
    card: dict[str, object]
    how: dict[str, Any]  # device, trackers, minutes, progress


class Stage(NamedTuple):
    """A sub-command of `train`."""

    summary: str
    source: str
    model: type[Config]
    training: type[Config]
    base: dict[str, dict[str, Any]]  # defaults that are not the configs'
    options: tuple[str, ...]  # each a flag and its field, such as "--rate training.learning_rate"
    train: Callable[[Given], None]
    add: Callable[[argparse.ArgumentParser], None] | None = None  # declares options that no field has
    examples: str | None = None


def shipped(part: str) -> dict[str, Any]:
    """The config of a part of the default bundle."""
    path = files("echoavatar") / "bundles" / "default" / part / "config.json"
    return read_object(path.read_bytes(), str(path))


def read_recipe(path: Path) -> dict[str, dict[str, Any]]:
    """The sections of a recipe. Raises EchoAvatarError if the file is missing, is not YAML, or has other sections."""
    found = read_yaml(read_text(path, "give the YAML file of a recipe", largest=YAML_BYTES), str(path))
    found = {} if found is None else found
    if not isinstance(found, dict) or not all(isinstance(found[key], dict) for key in found if key != PAPER):
        raise EchoAvatarError(f"{path}: a recipe has the sections {' and '.join(SECTIONS)}, each with settings")
    unknown = [key for key in found if key not in (*SECTIONS, PAPER)]
    if unknown:
        raise EchoAvatarError(f"{path}: unknown section {unknown[0]}; there are {' and '.join(SECTIONS)}")
    return found


def paper_recipe(recipe: Mapping[str, Any], path: Path) -> dict[str, dict[str, Any]]:
    """The paper's settings that a recipe names, changed by its own.

    Raises EchoAvatarError if there are none of that name.
    """
    if (settings := paper.RECIPES.get(str(recipe[PAPER]))) is None:
        raise EchoAvatarError(f"{path}: no paper: {recipe[PAPER]}; there are {', '.join(paper.RECIPES)}")
    values = {section: copy.deepcopy(dict(settings[section])) for section in SECTIONS}
    for section in values:
        _merge(values[section], recipe.get(section, {}))
    return values


def _merge(under: dict[str, Any], over: Mapping[str, Any]) -> None:
    """Merge `over` into `under`, nested mappings too."""
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(under.get(key), dict):
            _merge(under[key], value)
        else:
            under[key] = value
