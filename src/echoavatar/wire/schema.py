"""Generate descriptions of the messages for other languages: JSON Schema, and TypeScript types."""

import json
from collections.abc import Mapping
from typing import get_args

import msgspec

from echoavatar.timing import FRAME_RATE_HZ, SAMPLE_RATE_HZ, SAMPLES_PER_FRAME

from .codec import subprotocol
from .messages import CLOSE_CODES, ENCODINGS, MAX_MESSAGE_BYTES, VERSIONS, ClientMessage, ServerMessage
from .typescript import Schema, interface


def json_schema() -> Schema:
    """JSON Schema of all messages; `ClientMessage` and `ServerMessage` are in its `$defs`."""
    (client, server), parts = msgspec.json.schema_components([ClientMessage, ServerMessage])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"echoavatar.v{VERSIONS[-1]}",
        "description": "Messages of the JSON twin; in MessagePack the base64 strings are binary.",
        "$defs": {**parts, "ClientMessage": client, "ServerMessage": server},
        "anyOf": [{"$ref": "#/$defs/ClientMessage"}, {"$ref": "#/$defs/ServerMessage"}],
    }


def typescript() -> str:
    """TypeScript types of all messages. Blobs are Uint8Array; fields that the server always sends are not optional."""
    _, parts = msgspec.json.schema_components([ClientMessage, ServerMessage])
    sent = {kind.__name__ for kind in get_args(ServerMessage)} | {"Rig", "Latency", "Limits"}
    blocks = [_HEADER, _constants()]
    blocks += [interface(name, schema, complete=name in sent, named=_named) for name, schema in sorted(parts.items())]
    for name, union in (("ClientMessage", ClientMessage), ("ServerMessage", ServerMessage)):
        kinds = " | ".join(_named(kind.__name__) for kind in get_args(union))
        blocks.append(f"export type {name} = {kinds};")
    return "\n\n".join(blocks) + "\n"


_HEADER = "// Made from src/echoavatar/wire/messages.py by scripts/make_protocol.py; do not edit."


def _constants() -> str:
    values: Mapping[str, object] = {
        "VERSIONS": VERSIONS,
        "SUBPROTOCOLS": {kind: subprotocol(kind) for kind in ENCODINGS},
        "MAX_MESSAGE_BYTES": MAX_MESSAGE_BYTES,
        "SAMPLE_RATE": SAMPLE_RATE_HZ,
        "FRAME_RATE": FRAME_RATE_HZ,
        "SAMPLES_PER_FRAME": SAMPLES_PER_FRAME,
        "CLOSE_CODES": CLOSE_CODES,
    }
    return "\n".join(f"export const {name} = {_literal(value)};" for name, value in values.items())


def _literal(value: object) -> str:
    constant = not isinstance(value, int)
    return json.dumps(value, indent=2 if isinstance(value, dict) else None) + (" as const" if constant else "")


def _named(name: str) -> str:
    """Add a suffix to messages, because `Error` and `Audio` are names of the browser's own."""
    kinds = get_args(ClientMessage) + get_args(ServerMessage)
    return f"{name}Message" if name in {kind.__name__ for kind in kinds} else name
