"""The table of limits says what the code holds, and the tests that the table of attacks names exist."""

import dataclasses
import re
from pathlib import Path

import pytest

from echoavatar.server import ServerSettings
from echoavatar.server.clients import ClientRates
from echoavatar.wire.rates import TokenGate

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/security.md").read_text("utf-8")
LIMITS = re.findall(r"^\|[^|]+\| ([\d,]+)( MiB)? \| `([\w.]+)` \|$", PAGE, re.MULTILINE)
RATES = re.findall(r"^\|[^|]+\| ([\d,]+) \| ([\d,]+) \| `([\w.]+)` \|$", PAGE, re.MULTILINE)
TESTS = sorted(set(re.findall(r"`((?:studio/)?tests/[\w/]+\.py)(?:::(\w+))?`", PAGE)))


@pytest.mark.parametrize(("number", "unit", "name"), LIMITS, ids=lambda value: str(value).strip())
def test_limits_are_those_of_the_code(number: str, unit: str, name: str) -> None:
    place, _, last = name.rpartition(".")
    if place.endswith("ServerSettings"):
        value = getattr(ServerSettings(), last)
    else:
        value = getattr(
            pytest.importorskip(place if place.startswith("echoavatar_lab.") else f"echoavatar.{place}"), last
        )
    assert value == int(number.replace(",", "")) << (20 if unit else 0)


@pytest.mark.parametrize(("burst", "a_minute", "name"), RATES)
def test_rates_are_those_of_the_code(burst: str, a_minute: str, name: str) -> None:
    known = {**dataclasses.asdict(ClientRates()), "wire.rates.TokenGate.GUESSES": TokenGate.GUESSES}
    assert tuple(known[name]) == (int(burst.replace(",", "")), int(a_minute.replace(",", "")))


@pytest.mark.parametrize(("path", "name"), TESTS)
def test_tests_that_are_named_are_there(path: str, name: str) -> None:
    assert f"def {name}(" in (ROOT / path).read_text("utf-8") if name else (ROOT / path).is_file()


def test_the_tables_were_read() -> None:
    assert len(LIMITS) == PAGE.count("\n| ", PAGE.index("## Limits"), PAGE.index("## Rates")) - 1
    assert len(RATES) == PAGE.count("\n| ", PAGE.index("## Rates"), PAGE.index("## Attacks")) - 1
    assert len(TESTS) > 30
