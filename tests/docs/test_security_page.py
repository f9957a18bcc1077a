"""The table of limits says what the code holds, and the tests that the table of attacks names exist."""

import importlib
import re
from pathlib import Path

import pytest

from echoavatar.server import ServerSettings

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/security.md").read_text("utf-8")
LIMITS = re.findall(r"^\|[^|]+\| ([\d,]+)( MiB)? \| `([\w.]+)` \|$", PAGE, re.MULTILINE)
TESTS = sorted(set(re.findall(r"`((?:studio/)?tests/[\w/]+\.py)(?:::(\w+))?`", PAGE)))


@pytest.mark.parametrize(("number", "unit", "name"), LIMITS, ids=lambda value: str(value).strip())
def test_limits_are_those_of_the_code(number: str, unit: str, name: str) -> None:
    place, _, last = name.rpartition(".")
    if place.endswith("ServerSettings"):
        value = getattr(ServerSettings(), last)
    else:
        value = getattr(
            importlib.import_module(place if place.startswith("echoavatar_lab.") else f"echoavatar.{place}"), last
        )
    assert value == int(number.replace(",", "")) << (20 if unit else 0)


@pytest.mark.parametrize(("path", "name"), TESTS)
def test_tests_that_are_named_are_there(path: str, name: str) -> None:
    assert f"def {name}(" in (ROOT / path).read_text("utf-8") if name else (ROOT / path).is_file()


def test_the_tables_were_read() -> None:
    assert len(LIMITS) == PAGE.count("\n| ", PAGE.index("## Limits"), PAGE.index("## Attacks")) - 1
    assert len(TESTS) > 30
