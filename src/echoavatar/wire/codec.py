"""Messages to bytes and back: MessagePack on binary frames, its JSON twin (blobs in base64) on text frames."""

from collections.abc import Iterable
from typing import cast, get_args

import msgspec

from ..errors import EchoAvatarError
from .messages import (
    CLOSE_CODES,
    ENCODINGS,
    MAX_MESSAGE_BYTES,
    PROTOCOL,
    VERSIONS,
    ClientMessage,
    Encoding,
    ErrorCode,
    ServerMessage,
)


class ProtocolError(EchoAvatarError):
    """The other side said what cannot be said; `code` goes back to it in an `error`."""

    def __init__(
        self, code: ErrorCode, message: str, *, fatal: bool = True, retry_after: float = 0.0
    ) -> None:
        super().__init__(message)
        self.code: ErrorCode = code
        self.fatal = fatal
        self.retry_after = retry_after

    @property
    def close_code(self) -> int:
        """The WebSocket close code that goes with it."""
        return CLOSE_CODES[self.code]


_TO_CLIENT = (msgspec.msgpack.Decoder(ServerMessage), msgspec.json.Decoder(ServerMessage))
_TO_SERVER = (msgspec.msgpack.Decoder(ClientMessage), msgspec.json.Decoder(ClientMessage))
_ENCODERS = (msgspec.msgpack.Encoder(), msgspec.json.Encoder())


def subprotocol(encoding: Encoding, version: int = VERSIONS[-1]) -> str:
    """The WebSocket subprotocol's name, such as `echoavatar.v1.msgpack`."""
    return f"{PROTOCOL}.v{version}.{encoding}"


def negotiate(offered: Iterable[str]) -> tuple[Encoding, int] | None:
    """Encoding and version of the first offered subprotocol that is ours, the client's order first."""
    known = {
        subprotocol(encoding, version): (encoding, version) for version in VERSIONS for encoding in ENCODINGS
    }
    return next((known[name] for name in offered if name in known), None)


def encode(message: ClientMessage | ServerMessage, encoding: Encoding = "msgpack") -> bytes:
    """One message to the bytes of one frame."""
    return _ENCODERS[ENCODINGS.index(encoding)].encode(message)


def decode_client(frame: bytes | str, encoding: Encoding = "msgpack") -> ClientMessage:
    """What a client said.

    Raises:
        ProtocolError: bytes that are no message, a message that only servers send, or one that is too large.
    """
    try:
        return cast(ClientMessage, _TO_SERVER[_check(frame, encoding)].decode(_bytes(frame)))
    except _BROKEN as error:
        raise _refusal(frame, encoding, error) from error


def decode_server(frame: bytes | str, encoding: Encoding = "msgpack") -> ServerMessage | None:
    """What a server said; None for a kind of message that this version does not know, to be ignored.

    Raises:
        ProtocolError: bytes that are no message.
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
    """Index of the decoder, after the frame's kind and size were found right."""
    if isinstance(frame, str) != (encoding == "json"):
        kind = "text" if isinstance(frame, str) else "binary"
        raise ProtocolError("bad_message", f"a {kind} frame, but {subprotocol(encoding)} was agreed on")
    if len(frame) > MAX_MESSAGE_BYTES:
        raise ProtocolError(
            "too_large", f"a message of {len(frame)} bytes; at most {MAX_MESSAGE_BYTES} are accepted"
        )
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
        return ProtocolError("bad_message", f"this is no message: {error}")
    return ProtocolError("bad_message", f"no {kind[:32]!r} message as this side expects it: {error}")
