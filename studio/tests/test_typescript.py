"""JSON Schema as TypeScript."""

import pytest

from echoavatar_studio.typescript import interface, type_of


@pytest.mark.parametrize(
    ("schema", "wanted"),
    [
        ({"type": "integer"}, "number"),
        ({"type": "array", "items": {"anyOf": [{"type": "string"}, {"type": "null"}]}}, "(string | null)[]"),
        ({"type": "array", "prefixItems": [{"type": "number"}, {"type": "string"}]}, "[number, string]"),
        ({"type": "object", "additionalProperties": {"type": "number"}}, "Record<string, number>"),
        ({"enum": ["a", "b"]}, '"a" | "b"'),
        ({"const": True}, "true"),
        ({"$ref": "#/$defs/Thing"}, "Thing"),
        ({"type": "string", "contentEncoding": "base64"}, "Uint8Array"),
    ],
)
def test_types(schema, wanted):
    assert type_of(schema) == wanted


def test_unknown_schemas_are_not_guessed():
    with pytest.raises(NotImplementedError):
        type_of({"type": "tuple"})


def test_fields_with_defaults_are_optional_unless_always_sent():
    schema = {
        "description": "A thing.",
        "properties": {"a": {"type": "string"}, "b": {"type": "integer", "description": "how many"}},
        "required": ["a"],
    }
    text = interface("Thing", schema, complete=False, named=lambda name: f"{name}Message")
    lines = [
        "/** A thing. */",
        "export interface ThingMessage {",
        "  a: string;",
        "  /** how many */",
        "  b?: number;",
        "}",
    ]
    assert text.splitlines() == lines
    assert "  b: number;" in interface("Thing", schema, complete=True)
