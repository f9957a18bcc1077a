import json

import pytest

from echoavatar.agents.proxy.events import audio_format, interrupts, is_for_us, read, sound, with_tools


@pytest.mark.parametrize("text", ["", "[", '"a"', "{}", '{"type": 3}', '{"type":"a","item_id":4}', "[" * 9_000])
def test_malformed_events_are_none(text: str) -> None:
    assert read(text) is None


def test_fields_of_no_concern_do_not_disturb() -> None:
    event = read('{"type":"x","item_id":null,"delta":{"a":1},"unknown":[1,2]}')
    assert event is not None
    assert (event.type, event.item_id) == ("x", None)
    assert sound(event.delta) == b""


@pytest.mark.parametrize(("field", "data"), [("AAE=", b"\0\1"), ("***", b""), (None, b""), ("AAE", b""), (7, b"")])
def test_broken_sound_is_no_sound(field: object, data: bytes) -> None:
    assert sound(field) == data


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
        ({"output_audio_format": "opus"}, None),
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
    assert not is_for_us(b'{"type":"echoavatar.played"}')


def test_tools_are_added_to_updates_that_set_some_and_to_nothing_else() -> None:
    update = '{"type":"session.update","session":{"tools":[{"name":"a"}],"x":"\\u00e9"}}'
    changed = json.loads(with_tools(update, lambda own: [*own, {"name": "b"}]))
    assert changed["session"] == {"tools": [{"name": "a"}, {"name": "b"}], "x": "\u00e9"}
    for text in (
        '{"type":"session.update","session":{"instructions":"tools"}}',
        '{"type":"other","of":"session.update","session":{"tools":[]}}',
        '{"type":"session.update",',
        '{"type":"session.update","session":{"tools":[],"x":"\\ud800"}}',  # no text; the upstream may refuse it
        b'{"type":"session.update","session":{"tools":[]}}',
    ):
        assert with_tools(text, lambda own: ["changed"]) is text
