"""Read YAML that people write: plain values of a few levels, with no aliases and no tags.

libyaml reads where PyYAML has it, as its wheels do, or else Python, ten times as slowly. Uses `errors` only.
"""

from typing import Any

import yaml

from .errors import EchoAvatarError

YAML_BYTES = 1 << 16  # of a file; Python alone takes a second or two
LEVELS = 20  # of lists and mappings; in Python the time grows with the square of the open brackets
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_yaml(text: str, name: str) -> Any:
    """The value of a text, None of an empty one; `name` says in the message what it is.

    Raises EchoAvatarError: it is not YAML, is too deep, or has what plain values need not: an alias, which may name
    what holds it or hold a thousand copies of another, or a tag, for which PyYAML's loaders raise any error.
    """
    levels = 0
    try:
        for event in yaml.parse(text, _LOADER):
            levels += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if levels > LEVELS:
                raise yaml.YAMLError(f"it has more than {LEVELS} levels")
            if isinstance(event, yaml.AliasEvent):
                raise yaml.YAMLError("it has an alias (*name); write its values out")
            if tag := getattr(event, "tag", None):
                raise yaml.YAMLError(f"it has a tag ({tag}); leave it out")
        return yaml.load(text, _LOADER)
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # the last two: numbers, dates, surrogates
        raise EchoAvatarError(f"{name} is not YAML: {' '.join(str(error).split())[:200]}") from error
