"""JSON from outside is read within bounds, or refused in one line."""

import ast
import base64
import json
import os
import re
import tracemalloc
from pathlib import Path

import msgspec
import pytest

from echoavatar.errors import CheckpointError, EchoAvatarError
from echoavatar.json_reader import from_base64, read_json, read_object, read_object_file


@pytest.mark.parametrize("spelling", ["plain", "URL-safe", "form", "no padding", "lines"])
def test_base64_is_read_however_programs_spell_it(spelling: str) -> None:
    data = bytes(range(256)) + b"\xfb\xef\xbe\xff"
    text = base64.b64encode(data).decode()
    spelt = {
        "plain": text,
        "URL-safe": base64.urlsafe_b64encode(data).decode(),
        "form": text.replace("+", " "),
        "no padding": text.rstrip("="),
        "lines": "".join(f"  {text[at : at + 76]}\r\n" for at in range(0, len(text), 76)),
    }
    assert "+" in text
    assert from_base64(spelt[spelling]) == data


def test_what_json_can_say_is_read() -> None:
    value = {"text": "wave \U0001f44b \\ \x00", "numbers": [1, -2.5, 1e300, 10**20], "flags": [True, None], "in": {}}

    assert read_json(json.dumps(value), "it") == value
    assert read_json(json.dumps(value, ensure_ascii=False).encode(), "it") == value
    assert read_json(b"\xef\xbb\xbf[1]", "it") == [1], "a byte order mark, as Windows writes it"


@pytest.mark.parametrize(
    "text",
    [
        '"\\ud800"', '{"\\ud800": 1}', '"wave\\ud83d"', b'"\xed\xa0\x80"', '"\ud800"', b"\xff", "NaN", "-Infinity",
        "1e999", "-1e999", '{"a": [1E+400]}', "9" * 210 + "e99", f"[-1{'0' * 300}E+9]", "9" * 400, "9" * 5000,
        "[" * 4500, "[" * 300 + "]" * 300, '{"a":' * 300 + "1" + "}" * 300, "", "{", "[1] 2", "'a'",
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


def test_a_file_is_read_where_it_is_one(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with pytest.raises(FileNotFoundError):
        read_object_file(path)
    os.mkfifo(path)
    with pytest.raises(CheckpointError, match="not a regular file"):
        read_object_file(path, error=CheckpointError)
    path.unlink()
    path.write_bytes(b'\xef\xbb\xbf{"a": [1, 2]}')
    assert read_object_file(path) == {"a": [1, 2]}
    with pytest.raises(EchoAvatarError, match="more than 1 values"):
        read_object_file(path, most_values=1)


# ---- no other reader

ROOT = Path(__file__).parents[1]
READERS = {"json.loads", "json.load", "msgspec.json.decode", "model_validate_json", "json.JSONDecoder"}
OF_OUR_OWN = {
    "lab/src/echoavatar_lab/evaluation/motion_folder.py": "our own settings, brought to the form that JSON gives back",
    "lab/src/echoavatar_lab/models/export.py": "the header of weights that the checkpoint's reader has checked",
    "lab/src/echoavatar_lab/tables/experiment.py": "our own settings, brought to the form that JSON gives back",
    "scripts/release_check.py": "a manifest of this repository",
    "src/echoavatar/agents/proxy/bench.py": "what our own child process said",
    "src/echoavatar/bench/start.py": "what our own child process said",
    "studio/src/echoavatar_studio/http.py": "typed messages of bounded length; msgspec refuses surrogates and depth",
    "src/echoavatar/motion/formats/draco.py": "what its own parent writes",
    "src/echoavatar/server/video/encoder.py": "what its own parent writes",
    "studio/src/echoavatar_studio/page.py": "translations of the operator, a typed table of texts",
    "tools/character/src/echoavatar_character/base.py": "the tools' own data",
}  # file -> why it may read JSON by itself


def test_json_from_outside_has_one_reader() -> None:
    places = ("src", "lab/src", "studio/src", "integrations", "tools/character/src", "scripts")
    found = {
        str(path.relative_to(ROOT))
        for place in places
        for path in (ROOT / place).rglob("*.py")
        if "tests" not in path.parts and _reads_json(path)
    }
    assert found == set(OF_OUR_OWN), "use echoavatar.json_reader, or say here why not"


def _reads_json(path: Path) -> bool:
    source = path.read_bytes()
    if not re.search(rb"json\b|JSONDecoder", source):
        return False  # sooner than by parsing
    tree = ast.parse(source)
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    names = {ast.unparse(call) for call in calls if isinstance(call, ast.Attribute | ast.Name)}
    imported = {
        f"{node.module}.{name.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    return bool(READERS & (names | imported)) or any(name.endswith(".model_validate_json") for name in names)


@pytest.mark.parametrize("text", [b'"\\ud800"', b"[" * 100_000, b'{"a":' * 100_000, b'"\xed\xa0\x80"'])
def test_msgspec_refuses_what_the_reader_refuses(text: bytes) -> None:
    """The studio's messages are typed, and need no other reader."""
    with pytest.raises((msgspec.MsgspecError, UnicodeDecodeError, RecursionError)):
        msgspec.json.decode(text)
