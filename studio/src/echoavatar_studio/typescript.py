"""JSON Schema of structs as TypeScript interfaces, for the types of the protocol and of the studio."""

import json
from collections.abc import Callable, Iterable
from typing import Any

Schema = dict[str, Any]


def interface(name: str, schema: Schema, *, complete: bool, named: Callable[[str], str] = str) -> str:
    """An interface; with `complete` no field is optional, because the sender always sends all of them."""
    lines = [*_comment(schema), f"export interface {named(name)} {{"]
    required = schema.get("required", [])
    for field, what in schema.get("properties", {}).items():
        lines += [f"  {line}" for line in _comment(what)]
        lines.append(f"  {field}{'' if complete or field in required else '?'}: {type_of(what)};")
    return "\n".join([*lines, "}"])


def type_of(schema: Schema) -> str:
    """The TypeScript type of a field.

    Raises:
        NotImplementedError: no message has used this kind of schema so far.
    """
    match schema:
        case {"$ref": str(ref)}:
            return ref.rsplit("/", 1)[1]
        case {"enum": list(values)}:
            return " | ".join(json.dumps(value) for value in values)
        case {"const": value}:
            return json.dumps(value)
        case {"anyOf": list(choices)}:
            return " | ".join(type_of(choice) for choice in choices)
        case {"type": "array", "prefixItems": list(items)}:
            return f"[{', '.join(type_of(item) for item in items)}]"
        case {"type": "array", "items": dict(items)}:
            inner = type_of(items)
            return f"({inner})[]" if " " in inner else f"{inner}[]"
        case {"type": "object", "additionalProperties": dict(values)}:
            return f"Record<string, {type_of(values)}>"
        case {"type": "string", "contentEncoding": "base64"}:
            return "Uint8Array"
        case {"type": "integer" | "number"}:
            return "number"
        case {"type": "string" | "boolean" | "null" as kind}:
            return str(kind)
    raise NotImplementedError(f"no TypeScript type for {schema}")


def _comment(schema: Schema) -> Iterable[str]:
    return [f"/** {schema['description']} */"] if "description" in schema else []
