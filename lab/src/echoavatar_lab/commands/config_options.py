"""Options of commands that set fields of a config: name, type, choices and help come from the field."""

import argparse
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args, get_origin

from echoavatar.config import Config


def add_field(
    parser: argparse._ActionsContainer, flag: str, config: type[Config], name: str, *, default: Any = None
) -> argparse.Action:
    """Declare an option for a field that is a switch, a number, a text, a path or a literal; it has no default itself.

    The help names `default`, or the field's own where that is None. A switch that is on by default is turned off.
    """
    field = config.model_fields[name]
    own = field.default if default is None else default
    kind: Any = field.annotation
    if kind is bool:
        how: dict[str, Any] = {"action": "store_false" if own else "store_true"}
        text = f"turn off: {field.description}" if own else str(field.description)
    else:
        if type(None) in get_args(kind):
            (kind,) = (one for one in get_args(kind) if one is not type(None))
        is_literal = get_origin(kind) is Literal
        how = {"type": str if is_literal else kind, "choices": get_args(kind) if is_literal else None}
        text = f"{field.description} (default: {'none' if own is None else own})"
    return parser.add_argument(flag, default=None, help=text.replace("%", "%%"), **how)


def add_fields(
    parser: argparse._ActionsContainer,
    config: type[Config],
    names: Iterable[str],
    *,
    default: str | Mapping[str, Any] | None = None,
) -> None:
    """Declare `--NAME` for several fields, see `add_field`; a mapping holds what the help names by field."""
    for name in names:
        told = default.get(name) if isinstance(default, Mapping) else default
        add_field(parser, f"--{name.replace('_', '-')}", config, name, default=told)


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


NOT_TOLD = {"command", "kind", "source", "output", "stage", "options", "device", "track"}


def command_line(args: argparse.Namespace) -> str:
    """A command that trains, as the model's card states it: without the device and the trackers."""
    words = [f"echoavatar {args.command} {args.kind} {args.source} -o {args.output}"]
    for key, value in vars(args).items():
        if key not in NOT_TOLD and value not in (None, False, []):
            flag, values = f"--{key.replace('_', '-')}", value if isinstance(value, list) else [value]
            words += [flag if one is True else f"{flag} {one}" for one in values]
    return " ".join(words)
