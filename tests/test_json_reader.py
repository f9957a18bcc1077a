"""JSON from outside is read within bounds, or refused in one line."""

import json
import tracemalloc

import pytest

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import read_json, read_object


def test_what_json_can_say_is_read() -> None:
    value = {"text": "wave \U0001f44b \\ \x00", "numbers": [1, -2.5, 1e300, 10**20], "flags": [True, None], "in": {}}

    assert read_json(json.dumps(value), "it") == value
    assert read_json(json.dumps(value, ensure_ascii=False).encode(), "it") == value
    assert read_json(b"\xef\xbb\xbf[1]", "it") == [1], "a byte order mark, as Windows writes it"


@pytest.mark.parametrize(
    "text",
    [
        '"\\ud800"', '{"\\ud800": 1}', '"wave\\ud83d"', b'"\xed\xa0\x80"', '"\ud800"', b"\xff", "NaN", "-Infinity",
        "1e999", "-1e999", '{"a": [1E+400]}', "9" * 400, "9" * 5000, "[" * 4500, "[" * 300 + "]" * 300,
        '{"a":' * 300 + "1" + "}" * 300, "", "{", "[1] 2", "'a'",
    ],
)  # fmt: skip
def test_what_is_no_json_is_refused_in_one_line(text: bytes | str) -> None:
    with pytest.raises(CheckpointError, match="^card.json is not JSON: ") as caught:
        read_json(text, "card.json", error=CheckpointError)
    str(caught.value).encode()
    assert len(str(caught.value)) < 200


def test_text_that_only_looks_like_a_huge_number_is_read() -> None:
    assert read_json('{"sum": "0e999", "n": 1e-999}', "it") == {"sum": "0e999", "n": 0.0}


def test_bytes_and_values_are_bounded_before_anything_is_built() -> None:
    bomb = b"[" + b"[]," * (5 << 20) + b"[]]"
    tracemalloc.start()
    with pytest.raises(EchoAvatarError, match="at most 1,000 are read"):
        read_json(bomb, "it", most=1000)
    with pytest.raises(EchoAvatarError, match="values"):
        read_json(bomb, "it", most=len(bomb))
    with pytest.raises(EchoAvatarError, match="values"):
        read_json(b"[" * 100 + b"]" * 100 + (b"," + b"[" * 100 + b"]" * 100) * 20_000, "it")
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


def test_an_object_is_asked_for() -> None:
    assert read_object("{}", "it") == {}
    with pytest.raises(EchoAvatarError, match="it is not a JSON object"):
        read_object("[]", "it")
