"""The API's messages as TypeScript, for the pages in `web/studio`; `scripts/make_studio_types.py` writes it."""

import json
from collections.abc import Mapping

import msgspec

from .typescript import interface
from .wire import CATEGORIES, MAX_CLIPS, QUESTIONS, STATUS, Problem
from .wire_owner import OWNER_REPLIES, OWNER_REQUESTS
from .wire_rater import RATER_REPLIES, RATER_REQUESTS

_HEADER = "// Made from studio/src/echoavatar_studio/wire*.py by scripts/make_studio_types.py; do not edit."


def typescript() -> str:
    """Interfaces of all requests and replies, and the constants that pages share with the studio."""
    kinds = (Problem, *RATER_REQUESTS, *RATER_REPLIES, *OWNER_REQUESTS, *OWNER_REPLIES)
    _, parts = msgspec.json.schema_components(kinds)
    asked = {kind.__name__ for kind in (*RATER_REQUESTS, *OWNER_REQUESTS)}
    constants: Mapping[str, object] = {
        "STATUS": STATUS,
        "QUESTIONS": QUESTIONS,
        "CATEGORIES": CATEGORIES,
        "MAX_CLIPS": MAX_CLIPS,
    }
    values = "\n".join(f"export const {name} = {json.dumps(value)} as const;" for name, value in constants.items())
    blocks = [_HEADER, values]
    blocks += [interface(name, part, complete=name not in asked) for name, part in sorted(parts.items())]
    blocks.append("export type Answer = PairwiseAnswer | PreferenceAnswer | SkipAnswer;")
    return "\n\n".join(blocks) + "\n"
