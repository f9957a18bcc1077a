"""What a language model may do with the avatar, as function schemas; the names come from the engine's own library."""

from typing import Any

from ..engine import Engine

Schema = dict[str, Any]


def tool_schemas(engine: Engine, titles: tuple[str, ...]) -> list[Schema]:
    """In the form that OpenAI, Gemini, ElevenLabs and MCP derive theirs from: name, description, JSON Schema."""
    actions = list(engine.actions)
    return [
        _tool(
            "send_action",
            "Let the avatar do a gesture now, while it speaks or in silence. It ends by itself.",
            {
                "action": {"type": "string", "enum": actions, "description": "what to do"},
                "intensity": {"type": "number", "minimum": 0, "maximum": 2, "description": "1 is normal"},
                "hold": {"type": "number", "minimum": 0, "maximum": 60, "description": "seconds to hold it"},
            },
            ["action"],
        ),
        _tool(
            "play_music",
            "Play music; the avatar hears it and dances.",
            {"title": {"type": "string", "enum": list(titles), "description": "the first track if left out"}},
            [],
        ),
        _tool("stop_music", "Fade the music out.", {}, []),
        _tool("list_actions", "Name the gestures the avatar can do.", {}, []),
    ]


def _tool(name: str, description: str, properties: Schema, required: list[str]) -> Schema:
    parameters = {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }
    return {"name": name, "description": description, "parameters": parameters}
