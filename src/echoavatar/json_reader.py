"""Read JSON that comes from outside. Files, requests and answers all use this reader, so all have the same limits.

Python's own reader accepts a lone surrogate, which cannot be encoded again; any depth that its stack holds; NaN; and
any number of values, at 80 bytes of memory each. This reader refuses all four. It is pydantic's, which refuses
surrogates, NaN and more than 200 levels by itself. Uses `limits` and `errors` only.
"""

import base64
import codecs
import math
import re
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from .errors import EchoAvatarError
from .limits import CONFIG_BYTES, JSON_VALUES, read_bytes

# The parser reads 1e999 as infinity, and so 210 digits with an exponent of 99. Two searches take half as long as one.
_MAY_BE_INFINITE = re.compile(rb"[eE]\+?0*[1-9]\d\d"), re.compile(rb"\d{210}")

_FROM_URL = str.maketrans("-_ ", "+/+")  # URL-safe letters, and a + that was decoded as in a form


def from_base64(text: str) -> bytes:
    """The bytes in base64, URL-safe, form-decoded, in lines or unpadded too. Raises ValueError for other text."""
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        plain = "".join(line.strip() for line in text.splitlines()).translate(_FROM_URL).rstrip("=")
        return base64.b64decode(plain + "=" * (-len(plain) % 4), validate=True)


def read_json(
    data: object,
    name: str,
    *,
    most: int = CONFIG_BYTES,
    most_values: int = JSON_VALUES,
    error: type[EchoAvatarError] = EchoAvatarError,
) -> Any:
    """The value that JSON text holds; a byte order mark is passed over.

    Args:
        data: the text, or its bytes in UTF-8. Anything else is refused, since this too may come from outside.
        name: what the text is, for the message: "the body", a path.
        most: the largest number of bytes.
        most_values: the largest number of values.
        error: the class to raise.

    Raises:
        EchoAvatarError: of the given class: the text is not JSON, too long, or holds too many values, too many levels,
            a lone surrogate or a number that no float holds.
    """
    if not isinstance(data, bytes | str):
        raise error(f"{name} is not JSON: it is not text")
    try:
        raw = (data.encode() if isinstance(data, str) else data).removeprefix(codecs.BOM_UTF8)
        if len(raw) > most:
            raise error(f"{name} has {len(raw):,} bytes of JSON, and at most {most:,} are read")
        if sum(map(raw.count, (b",", b"[", b"{"))) >= most_values:  # `[[[]]]` has no comma
            raise error(f"{name} holds more than {most_values:,} values of JSON")
        value = from_json(raw, allow_inf_nan=False)
    except ValueError as reason:
        raise error(f"{name} is not JSON: {reason}") from reason
    if any(may.search(raw) for may in _MAY_BE_INFINITE) and not _is_finite(value):
        raise error(f"{name} is not JSON: it holds a number that no float holds")
    return value


def read_object(
    data: object, name: str, *, error: type[EchoAvatarError] = EchoAvatarError, **bounds: int
) -> dict[str, Any]:
    """The JSON object in a text; see `read_json`.

    Raises EchoAvatarError: of the given class: as `read_json`, or the value is not an object.
    """
    value = read_json(data, name, error=error, **bounds)
    if not isinstance(value, dict):
        raise error(f"{name} is not a JSON object")
    return value


def read_object_file(
    path: Path, *, most: int = CONFIG_BYTES, error: type[EchoAvatarError] = EchoAvatarError, **bounds: int
) -> dict[str, Any]:
    """The JSON object in a file; see `read_json`.

    Raises:
        FileNotFoundError: there is no such file; the caller knows the remedy.
        EchoAvatarError: of the given class: as `read_object`, or the file cannot be read.
    """
    return read_object(read_bytes(path, most, error), str(path), error=error, most=most, **bounds)


def _is_finite(value: object) -> bool:
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list):
        return all(map(_is_finite, value))
    if not isinstance(value, int | float):
        return True
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer larger than any float
        return False
