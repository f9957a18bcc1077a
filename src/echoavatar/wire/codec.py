"""Encode and decode messages: MessagePack in binary frames, or JSON (blobs in base64) in text frames."""

from collections.abc import Iterable
from typing import Any, cast, get_args

import msgspec

from echoavatar.errors import EchoAvatarError

from .messages import (
    ENCODINGS,
    MAX_MESSAGE_BYTES,
    PROTOCOL,
    VERSIONS,
    ClientMessage,
    Encoding,
    ErrorCode,
    ServerMessage,
)

TOO_LARGE = f"a message has at most {MAX_MESSAGE_BYTES:,} bytes; send long sound as several `audio` messages"


class ProtocolError(EchoAvatarError):
    """The peer sent something invalid; the fields are returned to it in an `error` message (`messages.Error`)."""

    def __init__(
        self, code: ErrorCode, message: str, *, fatal: bool = True, retry_after: float = 0.0, place: int = 0
    ) -> None:
        super().__init__(message)
        self.code: ErrorCode = code
        self.fatal = fatal
        self.retry_after, self.place = retry_after, place


class _Typed(msgspec.Struct):
    type: str


def _decoders(kind: Any) -> dict[Encoding, Any]:
    """Not strict: 24000.0 is a whole number, as some languages write it."""
    return {"msgpack": msgspec.msgpack.Decoder(kind, strict=False), "json": msgspec.json.Decoder(kind, strict=False)}


_TO_CLIENT, _TO_SERVER, _PEEK = (_decoders(kind) for kind in (ServerMessage, ClientMessage, _Typed))
_BROKEN = (msgspec.DecodeError, RecursionError, UnicodeError)
_SERVER_TYPES = tuple(kind.__struct_config__.tag for kind in get_args(ServerMessage))


def subprotocol(encoding: Encoding, version: int = VERSIONS[-1]) -> str:
    """Name of the WebSocket subprotocol, such as `echoavatar.v1.msgpack`."""
    return f"{PROTOCOL}.v{version}.{encoding}"


def negotiate(offered: Iterable[str]) -> tuple[Encoding, int] | None:
    """Encoding and version of the first offered subprotocol that is known, in the client's order."""
    known = {subprotocol(encoding, version): (encoding, version) for version in VERSIONS for encoding in ENCODINGS}
    return next((known[name] for name in offered if name in known), None)


def encode(message: ClientMessage | ServerMessage, encoding: Encoding = "msgpack") -> bytes:
    """Encode one message as one frame."""
    return msgspec.json.encode(message) if encoding == "json" else msgspec.msgpack.encode(message)


def decode_client(frame: bytes | str, encoding: Encoding = "msgpack") -> ClientMessage:
    """Decode a client's message.

    Raises ProtocolError if the frame is malformed or too large, or is a message that only servers send.
    """
    try:
        return cast(ClientMessage, _decode(_TO_SERVER, frame, encoding))
    except _BROKEN as error:
        raise _refusal(frame, encoding, error) from error


def decode_server(frame: bytes | str, encoding: Encoding = "msgpack") -> ServerMessage | None:
    """Decode a server's message; None for a type that this version does not know, which callers ignore.

    Raises ProtocolError if the frame is malformed.
    """
    try:
        return cast(ServerMessage, _decode(_TO_CLIENT, frame, encoding))
    except _BROKEN as error:
        if _type_of(frame, encoding) not in (None, *_SERVER_TYPES):
            return None
        raise _refusal(frame, encoding, error) from error


def _decode(decoders: dict[Encoding, Any], frame: bytes | str, encoding: Encoding) -> object:
    """Check the kind and size of a frame, and decode it."""
    if isinstance(frame, str) != (encoding == "json"):
        kind = "text" if isinstance(frame, str) else "binary"
        raise ProtocolError("bad_message", f"a {kind} frame, but {subprotocol(encoding)} was agreed on")
    if len(frame) > MAX_MESSAGE_BYTES:
        raise ProtocolError("too_large", TOO_LARGE)
    return decoders[encoding].decode(frame)


def _type_of(frame: bytes | str, encoding: Encoding) -> str | None:
    try:
        return str(_PEEK[encoding].decode(frame).type)
    except _BROKEN:
        return None


def _refusal(frame: bytes | str, encoding: Encoding, error: Exception) -> ProtocolError:
    kind = _type_of(frame, encoding)
    if kind is None:
        return ProtocolError("bad_message", f"this is not a message: {error}")
    return ProtocolError("bad_message", f"invalid {kind[:32]!r} message: {error}")
