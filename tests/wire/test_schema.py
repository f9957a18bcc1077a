"""The generated schema, types and fixtures agree with the messages."""

import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest

from echoavatar.wire.codec import decode_client, decode_server
from echoavatar.wire.messages import ServerMessage

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "tests" / "fixtures" / "wire"


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_protocol", ROOT / "scripts" / "make_protocol.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_committed_schema_types_and_fixtures_match_the_messages(maker: ModuleType) -> None:
    """After editing `wire/messages.py`, run `python scripts/make_protocol.py` and commit what it writes."""
    made = maker.files()
    stale = [str(path) for path, content in made.items() if (ROOT / path).read_bytes() != content]
    assert not stale, f"run python scripts/make_protocol.py; stale: {stale}"
    assert {path.name for path in made if path.parent.name == "wire"} == {path.name for path in FIXTURES.iterdir()}


def test_every_fixture_reads_as_the_message_it_is(maker: ModuleType) -> None:
    for name, message in maker.examples().items():
        decode = decode_server if isinstance(message, get_args(ServerMessage)) else decode_client
        assert decode((FIXTURES / f"{name}.bin").read_bytes()) == message
        assert decode((FIXTURES / f"{name}.json").read_text(), "json") == message


def test_schema_bounds_are_there(maker: ModuleType) -> None:
    schema = maker.json_schema()
    assert schema["$defs"]["Audio"]["properties"]["seg"]["minimum"] == 1
    json.dumps(schema)


def test_types_say_what_is_optional(maker: ModuleType) -> None:
    text = maker.typescript()
    assert "  resume?: string;" in text  # hello: may be left out
    assert "  resume: string;" in text  # ready: always there
    assert "export type ClientMessage = HelloMessage | AudioMessage |" in text
