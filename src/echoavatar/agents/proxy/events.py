"""The fields of Realtime events that the avatar needs; everything else is ignored, and so are malformed events.

Event names of the present protocol (`response.output_audio.delta`) and of its first version (`response.audio.delta`),
which other servers still use, are both known.
"""

import base64
import binascii
import json
from collections.abc import Callable
from typing import Any

import msgspec

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_json

AUDIO_DELTA = ("response.output_audio.delta", "response.audio.delta")
AUDIO_DONE = ("response.output_audio.done", "response.audio.done")
SESSION = ("session.created", "session.updated")


class Event(msgspec.Struct):
    """One event; absent fields are None."""

    type: str
    item_id: str | None = None
    response_id: str | None = None
    output_index: int | None = None
    content_index: int | None = None
    delta: Any = None  # base64 in audio events
    audio: Any = None  # base64, sent by the client
    audio_end_ms: float | None = None
    call_id: str | None = None
    name: str | None = None
    arguments: Any = None
    session: Any = None
    response: Any = None
    item: Any = None


_DECODER = msgspec.json.Decoder(Event, strict=False)  # 0.0 is a whole number, as some servers write it


def read(message: str | bytes) -> Event | None:
    """Parse an event; None if it is not one."""
    try:
        return _DECODER.decode(message)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return None


def sound(field: Any) -> bytes:
    """Decode a base64 field; empty if it is malformed."""
    if not isinstance(field, str):
        return b""
    try:
        return base64.b64decode(field, validate=True)
    except (binascii.Error, ValueError):
        return b""


def inside(value: Any, *path: str) -> Any:
    """A nested value; None if any key on the path is missing."""
    for key in path:
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


def audio_format(session: Any, direction: str) -> tuple[str, int] | None:
    """Encoding and rate of a session's `input` or `output`; None if the session does not specify them.

    The present protocol has `audio.output.format.type`, the first version `output_audio_format`.
    """
    form = inside(session, "audio", direction, "format") or inside(session, f"{direction}_audio_format")
    rate = inside(form, "rate")
    kind = inside(form, "type") if isinstance(form, dict) else form
    match kind:
        case "audio/pcmu" | "g711_ulaw":
            return "ulaw", 8_000
        case "audio/pcma" | "g711_alaw":
            return "alaw", 8_000
        case "audio/pcm" | "pcm16":
            is_rate = isinstance(rate, int | float) and 8_000 <= rate <= 192_000 and rate == int(rate)
            return "pcm", int(rate) if is_rate else 24_000
    return None


def interrupts(session: Any) -> bool | None:
    """Whether the user's voice interrupts the model; None if the session does not specify it."""
    for detection in (inside(session, "audio", "input", "turn_detection"), inside(session, "turn_detection")):
        if isinstance(detection, dict):
            return detection.get("interrupt_response") is not False
    return None


def tools_of(session: Any) -> list[Any] | None:
    """The tools of a session; None if it does not specify them."""
    tools = inside(session, "tools")
    return tools if isinstance(tools, list) else None


def is_for_us(message: str | bytes) -> bool:
    """Whether a client's event is addressed to the proxy."""
    if len(message) > 4_096 or not isinstance(message, str) or '"echoavatar.' not in message:
        return False
    event = read(message)
    return event is not None and event.type.startswith("echoavatar.")


def with_tools(message: str | bytes, add: Callable[[list[Any]], list[Any]]) -> str | bytes:
    """A client's `session.update` with its tools extended by `add`; any other message unchanged."""
    if not isinstance(message, str) or '"session.update"' not in message:
        return message
    try:
        event = read_json(message, "the event")
    except EchoAvatarError:
        return message
    own = tools_of(inside(event, "session"))
    if inside(event, "type") != "session.update" or own is None:
        return message
    event["session"]["tools"] = add(own)
    return json.dumps(event)
