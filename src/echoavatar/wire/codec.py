"""Encode and decode messages: MessagePack in binary frames, or JSON (blobs in base64) in text frames."""

from collections.abc import Iterable
from typing import cast, get_args

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
    """The peer sent something invalid; `code` is returned to it in an `error` message."""

    def __init__(
        self, code: ErrorCode, message: str, *, fatal: bool = True, retry_after: float = 0.0, place: int = 0
    ) -> None:
        super().__init__(message)
        self.code: ErrorCode = code
        self.fatal = fatal
        self.retry_after, self.place = retry_after, place


# Not strict: 24000.0 is a whole number, as some languages write it.
_TO_CLIENT = (msgspec.msgpack.Decoder(ServerMessage, strict=False), msgspec.json.Decoder(ServerMessage, strict=False))
_TO_SERVER = (msgspec.msgpack.Decoder(ClientMessage, strict=False), msgspec.json.Decoder(ClientMessage, strict=False))
_ENCODERS = (msgspec.msgpack.Encoder(), msgspec.json.Encoder())


def subprotocol(encoding: Encoding, version: int = VERSIONS[-1]) -> str:
    """Name of the WebSocket subprotocol, such as `echoavatar.v1.msgpack`."""
    return f"{PROTOCOL}.v{version}.{encoding}"


def negotiate(offered: Iterable[str]) -> tuple[Encoding, int] | None:
    """Encoding and version of the first offered subprotocol that is known, in the client's order."""
    known = {subprotocol(encoding, version): (encoding, version) for version in VERSIONS for encoding in ENCODINGS}
    return next((known[name] for name in offered if name in known), None)


def encode(message: ClientMessage | ServerMessage, encoding: Encoding = "msgpack") -> bytes:
    """Encode one message as one frame."""
    return _ENCODERS[ENCODINGS.index(encoding)].encode(message)


def decode_client(frame: bytes | str, encoding: Encoding = "msgpack") -> ClientMessage:
    """Decode a client's message.

    Raises:
        ProtocolError: the frame is malformed or too large, or is a message that only servers send.
    """
    try:
        return cast(ClientMessage, _TO_SERVER[_check(frame, encoding)].decode(_bytes(frame)))
    except _BROKEN as error:
        raise _refusal(frame, encoding, error) from error


def decode_server(frame: bytes | str, encoding: Encoding = "msgpack") -> ServerMessage | None:
    """Decode a server's message; None for a type that this version does not know, which is to be ignored.

    Raises:
        ProtocolError: the frame is malformed.
    """
    try:
        return cast(ServerMessage, _TO_CLIENT[_check(frame, encoding)].decode(_bytes(frame)))
    except _BROKEN as error:
        if _type_of(frame, encoding) not in (None, *_SERVER_TYPES):
            return None
        raise _refusal(frame, encoding, error) from error


_BROKEN = (msgspec.DecodeError, RecursionError, UnicodeError)
_SERVER_TYPES = tuple(kind.__struct_config__.tag for kind in get_args(ServerMessage))


class _Typed(msgspec.Struct):
    type: str


_PEEK = (msgspec.msgpack.Decoder(_Typed), msgspec.json.Decoder(_Typed))


def _check(frame: bytes | str, encoding: Encoding) -> int:
    """Check the kind and size of a frame; returns the decoder's index."""
    if isinstance(frame, str) != (encoding == "json"):
        kind = "text" if isinstance(frame, str) else "binary"
        raise ProtocolError("bad_message", f"a {kind} frame, but {subprotocol(encoding)} was agreed on")
    if len(frame) > MAX_MESSAGE_BYTES:
        raise ProtocolError("too_large", TOO_LARGE)
    return ENCODINGS.index(encoding)


def _bytes(frame: bytes | str) -> bytes:
    return frame if isinstance(frame, bytes) else frame.encode()


def _type_of(frame: bytes | str, encoding: Encoding) -> str | None:
    try:
        return _PEEK[ENCODINGS.index(encoding)].decode(_bytes(frame)).type
    except _BROKEN:
        return None


def _refusal(frame: bytes | str, encoding: Encoding, error: Exception) -> ProtocolError:
    kind = _type_of(frame, encoding)
    if kind is None:
        return ProtocolError("bad_message", f"this is not a message: {error}")
    return ProtocolError("bad_message", f"invalid {kind[:32]!r} message: {error}")
