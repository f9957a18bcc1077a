"""Defaults of options from a file and from the environment, which wins over the file; typed options win over both.

    # ~/.config/echoavatar/config.toml, or the file that $ECHOAVATAR_CONFIG names
    model = "bundles/mine"    # for every command that has --model
    [serve]
    port = 9000
    [bench.stream]
    seconds = 10

In the environment the option --sound-font of any command is ECHOAVATAR_SOUND_FONT, and only of `serve`
ECHOAVATAR_SERVE_SOUND_FONT.
"""

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from echoavatar.errors import EchoAvatarError
from echoavatar.limits import read_text

PREFIX = "ECHOAVATAR_"
_TRUE, _FALSE = ("1", "true", "yes", "on"), ("0", "false", "no", "off", "")


def config_path(environment: Mapping[str, str] = os.environ) -> Path:
    """The user's configuration file, which need not exist."""
    if named := environment.get(PREFIX + "CONFIG"):
        return _at_home(named)
    base = environment.get("APPDATA" if os.name == "nt" else "XDG_CONFIG_HOME", "")
    return _at_home(base if os.path.isabs(base) else "~/.config") / "echoavatar" / "config.toml"


def _at_home(path: str) -> Path:
    try:
        return Path(path).expanduser()
    except RuntimeError:  # no home folder: a container may run as a user without one
        return Path(path)


def apply(parser: argparse.ArgumentParser, command: str, environment: Mapping[str, str] = os.environ) -> None:
    """Set the defaults of a command's parser, and of its sub-commands.

    Raises:
        EchoAvatarError: the file cannot be read, its section for this command names an unknown option, or a value is
            impossible.
    """
    path, config = config_path(environment), dict[str, Any]()
    if PREFIX + "CONFIG" in environment or os.path.exists(path):  # Path.exists raises for a name that is too long
        import tomllib

        text = read_text(path, "repair this configuration, or remove it")
        try:
            config = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # also numbers of thousands of digits, and deep lists
            raise EchoAvatarError(f"cannot read the configuration {path}: {error}") from error
    for_all = {key: value for key, value in config.items() if not isinstance(value, dict)}
    section = _section(config, command, path)
    _apply(parser, (command,), for_all, section, environment, path)


def _apply(
    parser: argparse.ArgumentParser,
    words: tuple[str, ...],
    for_all: Mapping[str, Any],
    section: Mapping[str, Any],
    environment: Mapping[str, str],
    path: Path,
) -> None:
    known = set[str]()
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, child in action.choices.items():
                known.add(name)
                _apply(child, (*words, name), for_all, _section(section, name, path), environment, path)
        long = next((option[2:] for option in action.option_strings if option.startswith("--")), None)
        if long is None or isinstance(action, argparse._HelpAction | argparse._VersionAction):
            continue
        known.add(long)
        own = PREFIX + "_".join([*words, long]).upper().replace("-", "_")
        shared = PREFIX + long.upper().replace("-", "_")
        found = next((environment[name] for name in (own, shared) if environment.get(name)), None)  # empty is unset
        found = section.get(long, for_all.get(long)) if found is None else found
        if found is not None:
            action.default, action.required = _value(action, found, long), False
    if unknown := set(section) - known:
        raise EchoAvatarError(f"{path}: `{' '.join(words)}` has no option {sorted(unknown)[0]!r}")


def _section(config: Mapping[str, Any], name: str, path: Path) -> dict[str, Any]:
    section = config.get(name, {})
    if not isinstance(section, dict):
        raise EchoAvatarError(f"{path}: {name} is a command; write its options below [{name}]")
    return section


def _value(action: argparse.Action, found: Any, name: str) -> Any:
    """The default in the form that argparse expects: a text, which it converts, a list, or a boolean."""
    if isinstance(action, argparse._CountAction):
        return int(_converted(int, found, name))
    if action.nargs == 0:
        text = str(found).lower()
        if text not in _TRUE + _FALSE:
            raise EchoAvatarError(f"the setting {name} is {found!r}; it is true or false")
        return action.const if text in _TRUE else action.default
    if isinstance(action, argparse._AppendAction) or isinstance(action.nargs, int):
        texts = found if isinstance(found, list) else str(found).split(",")
        if isinstance(action.nargs, int) and len(texts) != action.nargs:
            raise EchoAvatarError(f"the setting {name} is {found!r}; it has {action.nargs} values")
        return [_converted(action.type or str, text, name) for text in texts]
    if action.choices is not None and found not in action.choices and str(found) not in map(str, action.choices):
        raise EchoAvatarError(f"the setting {name} is {found!r}; choose one of {', '.join(map(str, action.choices))}")
    return str(found)


def _converted(kind: Any, found: Any, name: str) -> Any:
    try:
        return kind(str(found))
    except (ValueError, TypeError, argparse.ArgumentTypeError) as error:
        raise EchoAvatarError(f"the setting {name} is {found!r}, which is not possible ({error})") from error
