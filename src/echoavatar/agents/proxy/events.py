"""The fields of Realtime events that the avatar needs, in the dialects of OpenAI, Azure, Alibaba, xAI and others.

Names are those of the present protocol (`response.output_audio.delta`) and of its first version
(`response.audio.delta`), which others still use. A field of an unexpected type counts as absent.
"""

import codecs
import json
import re
from collections.abc import Callable
from contextlib import suppress
from math import isfinite
from typing import Any

import msgspec
from pydantic_core import from_json

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import from_base64, read_json

from ..voice_formats import Format, named_format

AUDIO_DELTA, AUDIO_DONE = "audio.delta", "audio.done"  # ends of the events' names
PARTS_DONE = ("response.content_part.done", "response.output_item.done")
SESSION = ("session.created", "session.updated")
CUTS = ("response.cancel", "output_audio_buffer.clear", "response.cancelled", "output_audio_buffer.cleared")
MOST_BYTES = 1 << 22  # of an event that is read, a minute of sound: reading holds up other conversations
_RATE = re.compile(r"^(?!.*bit).*(?:rate|hz)", re.IGNORECASE)  # `rate`, `sampleRate`, `sample_rate_hz`
MOST_VALUES = 1 << 16  # in an event that is read


class Event(msgspec.Struct):
    """One event; absent fields are None, absent indices 0."""

    type: str
    item_id: Any = None  # text
    response_id: Any = None  # text
    output_index: Any = 0  # a whole number
    content_index: Any = 0  # a whole number
    delta: Any = None  # base64 in audio events
    audio: Any = None  # base64, sent by the client
    audio_end_ms: Any = None  # a number
    audio_offset_ms: Any = None  # a number, of a word
    audio_duration_ms: Any = None  # a number, of a word
    text: Any = None  # of a word
    call_id: Any = None  # text
    name: Any = None  # text
    arguments: Any = None
    session: Any = None
    response: Any = None
    item: Any = None

    def __post_init__(self) -> None:
        self.item_id = identity(self.item_id) or identity(inside(self.item, "id"))
        self.response_id = identity(self.response_id) or identity(inside(self.response, "id"))
        self.call_id, self.name = identity(self.call_id), identity(self.name)
        self.output_index = round(_number(self.output_index) or 0)
        self.content_index = round(_number(self.content_index) or 0)
        self.audio_end_ms, self.audio_offset_ms = _number(self.audio_end_ms), _number(self.audio_offset_ms)
        self.audio_duration_ms = _number(self.audio_duration_ms)


_DECODER = msgspec.json.Decoder(Event, strict=False)  # 0.0 is a whole number, as some servers write it


def read(message: str | bytes) -> Event | None:
    """Parse an event; None if it is not one, or too large. Such a message is forwarded all the same."""
    try:
        raw = message.encode() if isinstance(message, str) else message
        is_large = len(raw) > MOST_BYTES or sum(map(raw.count, (b",", b"[", b"{"))) > MOST_VALUES
        if is_large:
            return None
        with suppress(msgspec.DecodeError):
            return _DECODER.decode(raw)
        plain = from_json(raw.removeprefix(codecs.BOM_UTF8))  # some servers write NaN or a byte order mark
        return msgspec.convert(plain, Event, strict=False)
    except (msgspec.DecodeError, ValueError, RecursionError):
        return None


def sound(field: Any) -> bytes | None:
    """Decode a base64 field of any dialect, also a `data:` address; None if it is not base64."""
    with suppress(AttributeError, ValueError):
        return from_base64(field.rpartition(";base64,")[2])
    return None


def identity(value: Any) -> str | None:
    """An id as text; None if it is neither a text nor a whole number."""
    return str(value) if isinstance(value, str | int) and not isinstance(value, bool) and value != "" else None


def _number(value: Any) -> float | None:
    with suppress(TypeError, ValueError, OverflowError):
        return number if isfinite(number := float(value)) else None
    return None


def inside(value: Any, *path: str) -> Any:
    """A nested value; None if any key on the path is missing."""
    for key in path:
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


def audio_format(session: Any, direction: str) -> Format | None:
    """Encoding and rate of a session's `input` or `output`; None if the session does not specify them.

    The present protocol has `audio.output.format.type`, the first version `output_audio_format`. Azure states the rate
    beside it (`input_audio_sampling_rate`), and Alibaba's speech has `response_format` and `sample_rate`. Others have
    `encoding` and their own names of the rate.
    """
    form = inside(session, "audio", direction, "format") or inside(session, f"{direction}_audio_format")
    if form is None and direction == "output":
        form = inside(session, "response_format")
    fields = form if isinstance(form, dict) else {}
    said = [fields.get(key) for key in ("type", "encoding")]
    kind = " ".join(word for word in said if isinstance(word, str)) if fields else form
    rates = [value for key, value in fields.items() if _RATE.search(key)]
    rates += [inside(session, f"{direction}_audio_{key}") for key in ("sampling_rate", "sample_rate")]
    rate = next((found for found in (*rates, inside(session, "sample_rate")) if found is not None), None)
    if not (kind and isinstance(kind, str)):
        kind = "pcm" if rate is not None else ""
    if (channels := _number(inside(form, "channels")) or 1) > 1:
        kind += f";channels={channels:.0f}"
    return named_format(kind, rate) if kind else None


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
    if len(message) > 4_096 or not _holds(message, '"echoavatar.'):
        return False
    event = read(message)
    return event is not None and event.type.startswith("echoavatar.")


def with_tools(message: str | bytes, add: Callable[[list[Any]], list[Any]]) -> str | bytes:
    """A client's `session.update` with its tools extended by `add`; any other message unchanged."""
    if not _holds(message, '"session.update"'):
        return message
    try:
        event = read_json(message, "the event", most=MOST_BYTES, most_values=MOST_VALUES)
    except EchoAvatarError:
        return message
    own = tools_of(inside(event, "session"))
    if inside(event, "type") != "session.update" or own is None:
        return message
    event["session"]["tools"] = add(own)
    text = json.dumps(event)
    return text if isinstance(message, str) else text.encode()


def _holds(message: str | bytes, word: str) -> bool:
    """Whether a message, in a frame of text or of bytes, has a word in it."""
    return word in message if isinstance(message, str) else word.encode() in message
