import json
import time

import pytest

from echoavatar.agents.proxy.events import audio_format, interrupts, is_for_us, read, sound, with_tools


@pytest.mark.parametrize("text", ["", "[", '"a"', "{}", '{"type": 3}', "[" * 9_000])
def test_malformed_events_are_none(text: str) -> None:
    assert read(text) is None


@pytest.mark.parametrize(
    "text",
    [
        '{"type": "x", "item": [' + "[]," * 5_000_000 + "[]]}",
        '{"type": "session.update", "session": {"tools": [' + "{}," * 1_000_000 + "{}]}}",
        '{"type": "x", "delta": "' + "A" * 15_000_000 + '"}',
    ],
    ids=["lists", "tools", "sound"],
)
def test_an_event_that_would_hold_up_others_is_not_read(text: str) -> None:
    began = time.thread_time()
    assert read(text) is None
    assert with_tools(text, list.copy) is text
    assert time.thread_time() - began < 0.1
    assert read('{"type": "x", "delta": "' + "A" * 4_000_000 + '"}') is not None


def test_fields_of_no_concern_do_not_disturb() -> None:
    event = read('{"type":"x","item_id":null,"delta":{"a":1},"unknown":[1,2]}')
    assert event is not None
    assert (event.type, event.item_id) == ("x", None)
    assert sound(event.delta) is None


@pytest.mark.parametrize(
    ("field", "data"),
    [
        ("AAE=", b"\0\1"), ("AAE", b"\0\1"), ("A\nAE=\r\n", b"\0\1"), ("-_8", b"\xfb\xff"), ("+/8=", b"\xfb\xff"),
        ("data:audio/pcm;base64,AAE=", b"\0\1"),
        ("", b""), ("***", None), (None, None), ("AAEAA", None), (7, None), ("ä", None), ([0, 1], None),
    ],
)  # fmt: skip
def test_base64_of_any_dialect_is_sound(field: object, data: bytes | None) -> None:
    assert sound(field) == data


@pytest.mark.parametrize(
    "text",
    [
        '{"type":"x","item_id":"i","score":NaN}',
        '{"type":"x","item_id":"i","score":[-Infinity]}',
        '\ufeff{"type":"x","item_id":"i"}\n',
    ],
)
def test_json_as_some_servers_write_it(text: str) -> None:
    for message in (text, text.encode()):
        event = read(message)
        assert event is not None
        assert (event.type, event.item_id) == ("x", "i")


def test_fields_of_another_type_are_read_as_far_as_they_can_be() -> None:
    event = read(
        '{"type":"x","item_id":4,"response_id":["r"],"content_index":"1","output_index":null,"audio_end_ms":"9"}'
    )
    assert event is not None
    assert (event.item_id, event.response_id, event.content_index, event.output_index) == ("4", None, 1, 0)
    assert event.audio_end_ms == 9.0
    other = read('{"type":"x","response":{"id":"r"},"item":{"id":"i"},"audio_end_ms":[1],"content_index":"nan"}')
    assert other is not None
    assert (other.item_id, other.response_id, other.content_index, other.audio_end_ms) == ("i", "r", 0, None)


@pytest.mark.parametrize(
    ("session", "form"),
    [
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": 24000}}}}, ("pcm", 24_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": 16000}}}}, ("pcm", 16_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": "fast"}}}}, ("pcm", 24_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": 48000.0}}}}, ("pcm", 48_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": 16000.5}}}}, ("pcm", 24_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcmu"}}}}, ("ulaw", 8_000)),
        ({"output_audio_format": "g711_alaw"}, ("alaw", 8_000)),
        ({"output_audio_format": "pcm16"}, ("pcm", 24_000)),
        ({"output_audio_format": "opus"}, ("opus", 8_000)),
        ({"output_audio_format": "pcm24"}, ("pcm", 24_000)),
        ({"output_audio_format": "pcm"}, ("pcm", 24_000)),
        ({"audio": {"output": {"format": {"encoding": "mulaw", "sample_rate": 8000}}}}, ("ulaw", 8_000)),
        ({"output_audio_format": {"type": "raw", "encoding": "pcm_s16le", "sampleRate": 16000}}, ("pcm", 16_000)),
        ({"output_audio_format": {"type": "audio/pcm", "sample_rate_hz": 16000, "bit_rate": 9000}}, ("pcm", 16_000)),
        ({"output_audio_format": "pcm16_8000hz"}, ("pcm", 8_000)),
        ({"output_audio_format": "pcm16-16000hz"}, ("pcm", 16_000)),
        ({"output_audio_format": "PCM16", "output_audio_sampling_rate": 16000}, ("pcm", 16_000)),
        ({"response_format": "pcm", "sample_rate": "16000"}, ("pcm", 16_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": 16000.0}}}}, ("pcm", 16_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "sample_rate": 48000}}}}, ("pcm", 48_000)),
        ({"audio": {"output": {"format": "g711_ulaw"}}}, ("ulaw", 8_000)),
        ({"audio": {"output": {"format": {"type": "audio/PCMA", "rate": 8000}}}}, ("alaw", 8_000)),
        ({"output_audio_format": "pcm_f32le"}, ("pcm_f32le", 8_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "rate": 24000, "channels": 1}}}}, ("pcm", 24_000)),
        ({"audio": {"output": {"format": {"type": "audio/pcm", "channels": 2}}}}, ("audio/pcm;channels=2", 24_000)),
        ({"output_audio_format": "raw-16khz-16bit-mono-pcm"}, ("pcm", 16_000)),
        ({"output_audio_format": 7}, None),
        ({"voice": "alloy"}, None),
        ("nonsense", None),
        ({"audio": []}, None),
    ],
)
def test_formats_of_both_protocols_are_known(session: object, form: tuple[str, int] | None) -> None:
    assert audio_format(session, "output") == form


def test_a_session_says_whether_the_user_cuts_in() -> None:
    assert interrupts({"turn_detection": {"interrupt_response": False}}) is False
    assert interrupts({"audio": {"input": {"turn_detection": {"type": "server_vad"}}}}) is True
    assert interrupts({"audio": {"input": {"turn_detection": None}}}) is None


def test_only_our_own_events_are_ours() -> None:
    assert is_for_us('{"type":"echoavatar.played"}')
    assert not is_for_us('{"type":"conversation.item.create","item":{"text":"\\"echoavatar.played"}}')
    assert is_for_us(b'{"type":"echoavatar.played"}')
    assert not is_for_us(b"\xff\x00 echoavatar.")


def test_tools_are_added_to_updates_that_set_some_and_to_nothing_else() -> None:
    update = '{"type":"session.update","session":{"tools":[{"name":"a"}],"x":"\\u00e9"}}'
    changed = json.loads(with_tools(update, lambda own: [*own, {"name": "b"}]))
    assert changed["session"] == {"tools": [{"name": "a"}, {"name": "b"}], "x": "\u00e9"}
    for text in (
        '{"type":"session.update","session":{"instructions":"tools"}}',
        '{"type":"other","of":"session.update","session":{"tools":[]}}',
        '{"type":"session.update",',
        '{"type":"session.update","session":{"tools":[],"x":"\\ud800"}}',  # no text; the upstream may refuse it
        b'\xff"session.update"',
    ):
        assert with_tools(text, lambda own: ["changed"]) is text
    in_bytes = with_tools(b'{"type":"session.update","session":{"tools":[]}}', lambda own: ["changed"])
    assert isinstance(in_bytes, bytes)
    assert json.loads(in_bytes)["session"]["tools"] == ["changed"]
