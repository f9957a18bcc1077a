"""Recipes: the settings of a training stage in a YAML file.

    training:
      learning_rate: 2.0e-4
    model:
      width: 256

Options on the command line win over the recipe, which wins over the options' defaults. Unknown keys are errors.
"""

import argparse
import copy
import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import yaml
from pydantic import ValidationError

from echoavatar.config import Config
from echoavatar.errors import EchoAvatarError

SECTIONS = ("model", "training")
ConfigT = TypeVar("ConfigT", bound=Config)


class _Field(NamedTuple):
    section: str
    name: str
    default: Any
    is_inverted: bool


class Options:
    """The options of a sub-command that set fields of its configs."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self._parser, self._fields = parser, dict[str, _Field]()
        parser.add_argument(
            "--recipe", type=Path, metavar="YAML", help="file of settings; options on the command line win over it"
        )
        parser.set_defaults(options=self)

    def add(self, flag: str, field: str, default: Any, *, help: str, **how: Any) -> None:
        """Declare an option for `section.name`; without a default the config's own applies."""
        section, name = field.split(".")
        is_flag = how.get("action") == "store_true"
        shown = "" if default is None or is_flag else f" (default: {default})"
        action = self._parser.add_argument(flag, default=None, help=help + shown, **how)
        self._fields[action.dest] = _Field(section, name, default, is_flag and default is True)

    def add_minutes(self) -> None:
        """Declare `--minutes`, which ends a call but not the run."""
        self._parser.add_argument(
            "--minutes", type=float, help="stop this call after so many minutes; call again to resume"
        )

    def settings(self, args: argparse.Namespace, base: Mapping[str, Mapping[str, Any]] | None = None) -> "Settings":
        """Merge the settings; priority: command line, recipe, the options' defaults, `base`."""
        values: dict[str, dict[str, Any]] = {section: {} for section in SECTIONS}
        for section, found in (base or {}).items():
            values[section] = copy.deepcopy(dict(found))
        for field in self._fields.values():
            if field.default is not None:
                values[field.section][field.name] = field.default
        recipe = read_recipe(args.recipe) if args.recipe else {}
        for section, found in recipe.items():
            _merge(values[section], found)
        for dest, field in self._fields.items():
            given = getattr(args, dest)
            if given is not None:
                values[field.section][field.name] = (not given) if field.is_inverted else given
        named = {(f.section, f.name) for d, f in self._fields.items() if getattr(args, d) is not None}
        named |= {(section, name) for section, found in recipe.items() for name in found}
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

        Raises:
            EchoAvatarError: a key is unknown, or a value is invalid; names both.
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


def read_recipe(path: Path) -> dict[str, dict[str, Any]]:
    """The sections of a recipe.

    Raises:
        EchoAvatarError: the file is missing, is not YAML, or has other sections.
    """
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EchoAvatarError(f"cannot read the recipe {path} ({error.strerror})") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise EchoAvatarError(f"{path} is not YAML: {error}") from error
    found = {} if found is None else found
    if not isinstance(found, dict) or not all(isinstance(value, dict) for value in found.values()):
        raise EchoAvatarError(f"{path}: a recipe has the sections {' and '.join(SECTIONS)}, each with settings")
    unknown = [key for key in found if key not in SECTIONS]
    if unknown:
        raise EchoAvatarError(f"{path}: unknown section {unknown[0]}; there are {' and '.join(SECTIONS)}")
    return found


def _merge(under: dict[str, Any], over: Mapping[str, Any]) -> None:
    """Merge `over` into `under`, nested mappings too."""
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(under.get(key), dict):
            _merge(under[key], value)
        else:
            under[key] = value
