"""Options of commands that set fields of a config: name, type, choices and help come from the field."""

import argparse
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args, get_origin

from echoavatar.config import Config


def add_fields(
    parser: argparse._ActionsContainer,
    config: type[Config],
    names: Iterable[str],
    *,
    default: str | Mapping[str, Any] | None = None,
) -> None:
    """Declare `--NAME` for fields that are numbers, texts, paths or literals; the option itself has no default.

    The help names the field's default, `default` if it is a text, or the values that `default` holds by name.
    """
    for name in names:
        field = config.model_fields[name]
        kind: Any = field.annotation
        if type(None) in get_args(kind):
            (kind,) = (one for one in get_args(kind) if one is not type(None))
        is_literal = get_origin(kind) is Literal
        own = default.get(name, field.default) if isinstance(default, Mapping) else default or field.default
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            type=str if is_literal else kind,
            choices=get_args(kind) if is_literal else None,
            help=f"{field.description} (default: {'none' if own is None else own})".replace("%", "%%"),
        )


def given_fields(args: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """The fields whose options were given; a field may have no option."""
    return {name: value for name in names if (value := getattr(args, name, None)) is not None}


def add_minutes(parser: argparse._ActionsContainer) -> None:
    """Declare `--minutes`, which ends a call but not the run."""
    parser.add_argument("--minutes", type=float, help="stop this call after so many minutes; call again to resume")


def add_track(parser: argparse._ActionsContainer) -> None:
    """Declare `--track`."""
    parser.add_argument(
        "--track",
        action="append",
        default=[],
        choices=("tensorboard", "wandb"),
        help="log metrics of training there as well as in metrics.jsonl; may be given twice",
    )
