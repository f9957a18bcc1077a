"""Messages survive encoding and decoding; malformed bytes are refused."""

import math
from contextlib import suppress

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echoavatar.wire.codec import ProtocolError, decode_client, decode_server, encode, negotiate, subprotocol
from echoavatar.wire.messages import (
    CLOSE_CODES,
    MAX_MESSAGE_BYTES,
    Action,
    Audio,
    AudioFormat,
    ClientMessage,
    Encoding,
    End,
    Hello,
    Interrupt,
    Music,
    Ping,
    Played,
    Pong,
)

samples = st.integers(0, 2**53 - 1)
segments = st.integers(1, 2**31 - 1)
names = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=128)
messages = st.one_of(
    st.builds(Hello, token=names, seed=st.integers(0, 2**31 - 1), played=samples),
    st.builds(Audio, seg=segments, start=samples, pcm=st.binary(), speaker=st.sampled_from(["avatar", "user"])),
    st.builds(End, seg=segments),
    st.builds(Interrupt, heard=st.none() | samples, seg=st.integers(0, 2**31 - 1)),
    st.builds(Action, id=names, name=names, intensity=st.floats(0, 2), hold=st.none() | st.floats(0, 60)),
    st.builds(Music, id=names, op=st.sampled_from(["play", "stop"]), title=names),
    st.builds(Played, at=samples, epoch=st.integers(0, 1 << 20)),
    st.builds(Ping, nonce=samples),
)


def framed(content: bytes, encoding: Encoding) -> bytes | str:
    return content.decode() if encoding == "json" else content


@given(message=messages, encoding=st.sampled_from(["msgpack", "json"]))
def test_messages_survive_encoding_and_decoding(message: ClientMessage, encoding: Encoding) -> None:
    assert decode_client(framed(encode(message, encoding), encoding), encoding) == message


@given(content=st.binary(max_size=300))
@settings(max_examples=300, deadline=None)
def test_garbage_is_a_protocol_error_and_nothing_else(content: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_client(content)
    with pytest.raises(ProtocolError):
        decode_client(content.decode("latin-1"), "json")


@given(message=messages, cut=st.floats(0, 0.999), flip=st.integers(0, 255))
@settings(max_examples=300, deadline=None)
def test_truncated_and_damaged_messages_are_refused_or_valid(message: ClientMessage, cut: float, flip: int) -> None:
    content = encode(message)
    with pytest.raises(ProtocolError):
        decode_client(content[: int(len(content) * cut)])
    damaged = bytearray(content)
    damaged[int(len(content) * cut)] ^= flip
    with suppress(ProtocolError):
        decode_client(bytes(damaged))


def test_a_client_that_sends_motion_is_refused() -> None:
    with pytest.raises(ProtocolError, match="motion") as caught:
        decode_client(msgspec.msgpack.encode({"type": "motion", "at": 0}))
    assert CLOSE_CODES[caught.value.code] == 4400


def test_a_deep_nest_is_refused() -> None:
    with pytest.raises(ProtocolError):
        decode_client("[" * 100_000, "json")
    with pytest.raises(ProtocolError):
        decode_client(b"\x91" * 100_000)


def test_a_huge_message_is_refused_by_size() -> None:
    with pytest.raises(ProtocolError, match="at most") as caught:
        decode_client(encode(Audio(seg=1, start=0, pcm=bytes(MAX_MESSAGE_BYTES))))
    assert CLOSE_CODES[caught.value.code] == 1009


@pytest.mark.parametrize(
    "content",
    [
        {"type": "audio", "seg": 0, "start": 0, "pcm": b""},
        {"type": "audio", "seg": 1, "start": -1, "pcm": b""},
        {"type": "audio", "seg": 2**40, "start": 0, "pcm": b""},
        {"type": "audio", "seg": 1, "start": 0, "pcm": "text"},
        {"type": "audio", "seg": 1, "start": 2**63, "pcm": b""},
        {"type": "action", "id": "a", "name": "wave", "intensity": math.nan},
        {"type": "action", "id": "a", "name": "wave", "intensity": math.inf},
        {"type": "action", "id": "", "name": "wave"},
        {"type": "action", "id": "x" * 129, "name": "wave"},
        {"type": "hello", "versions": []},
        {"type": "hello", "audio": {"rate": 0}},
        {"type": "played", "at": 1.5},
        {"type": "ping", "nonce": 2**53},
    ],
    ids=str,
)
def test_values_out_of_bounds_are_refused(content: dict[str, object]) -> None:
    with pytest.raises(ProtocolError):
        decode_client(msgspec.msgpack.encode(content))


def test_fields_of_a_later_version_are_ignored() -> None:
    assert decode_client(b'{"type":"ping","nonce":3,"mood":"good"}'.decode(), "json") == Ping(nonce=3)


def test_messages_of_a_later_version_are_ignored_by_clients_and_refused_by_servers() -> None:
    later = msgspec.msgpack.encode({"type": "weather", "rain": True})
    assert decode_server(later) is None
    with pytest.raises(ProtocolError, match="weather"):
        decode_client(later)


def test_a_damaged_message_from_a_server_is_an_error() -> None:
    with pytest.raises(ProtocolError, match="pong"):
        decode_server(msgspec.msgpack.encode({"type": "pong"}))
    assert decode_server(encode(Pong(nonce=1, at=2))) == Pong(nonce=1, at=2)


def test_text_and_binary_frames_are_not_mixed() -> None:
    with pytest.raises(ProtocolError, match="text frame"):
        decode_client('{"type":"ping"}', "msgpack")
    with pytest.raises(ProtocolError, match="binary frame"):
        decode_client(b'{"type":"ping"}', "json")


def test_the_first_known_subprotocol_is_taken() -> None:
    assert subprotocol("msgpack") == "echoavatar.v1.msgpack"
    assert negotiate(["chat", "echoavatar.v1.json", "echoavatar.v1.msgpack"]) == ("json", 1)
    assert negotiate(["echoavatar.v9.msgpack"]) is None


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_whole_numbers_may_be_written_with_a_point(encoding: Encoding) -> None:
    """Lua and JavaScript know one kind of number; others write what they measured."""
    packed = msgspec.msgpack.encode if encoding == "msgpack" else (lambda value: msgspec.json.encode(value).decode())
    hello = decode_client(packed({"type": "hello", "audio": {"rate": 48_000.0}, "seed": 7.0, "played": 3.0}), encoding)
    assert hello == Hello(audio=AudioFormat(rate=48_000), seed=7, played=3)
    assert decode_client(packed({"type": "played", "at": 6_400.0, "epoch": 1.0}), encoding) == Played(at=6_400, epoch=1)
    assert decode_client(packed({"type": "interrupt", "heard": 5.0}), encoding) == Interrupt(heard=5)
    for wrong in (24_000.5, 1e300, -1.0, True, "many"):
        with pytest.raises(ProtocolError):
            decode_client(packed({"type": "hello", "audio": {"rate": wrong}}), encoding)
