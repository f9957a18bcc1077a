"""The table of limits says what the code holds, and each promise of the page names a test that exists."""

import dataclasses
import re
from importlib import import_module
from pathlib import Path

import pytest

from echoavatar.errors import DependencyError
from echoavatar.server import ServerSettings
from echoavatar.server.clients import ClientRates
from echoavatar.wire.rates import TokenGate

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/security.md").read_text("utf-8")
LIMITS = re.findall(r"^\|[^|]+\| ([\d,]+)( MiB)? \| `([\w.]+)`, ", PAGE, re.MULTILINE)
RATES = re.findall(r"^\|[^|]+\| ([\d,]+) \| ([\d,]+) \| `([\w.]+)` \|$", PAGE, re.MULTILINE)
A_TEST = re.compile(r"`((?:studio/|lab/)?tests/[\w/]+\.py)(?:::(\w+))?`")
TESTS = sorted(set(A_TEST.findall(PAGE)))
COMMANDS = ("echoavatar bench soak", "python -m tests.server.fault_drill")  # rows that a command shows, not a test
OPERATORS = (  # what the page asks of the operator, and so no test can hold
    "A `.env`",
    "A backup holds hashes",
)


def part(title: str) -> str:
    """The text below a heading of the page."""
    return PAGE.split(f"\n## {title}")[1].split("\n## ")[0]


def rows(title: str) -> list[str]:
    """The rows of the table in a part, without its head."""
    return [line for line in part(title).splitlines() if line.startswith("| ")][1:]


@pytest.mark.parametrize(("number", "unit", "name"), LIMITS, ids=lambda value: str(value).strip())
def test_limits_are_those_of_the_code(number: str, unit: str, name: str) -> None:
    place, _, last = name.rpartition(".")
    if place.endswith("ServerSettings"):
        value = getattr(ServerSettings(), last)
    else:
        try:
            module = import_module(place if place.startswith("echoavatar_lab.") else f"echoavatar.{place}")
        except DependencyError as error:
            pytest.skip(str(error))
        value = getattr(module, last)
    assert value == int(number.replace(",", "")) << (20 if unit else 0)


@pytest.mark.parametrize(("burst", "a_minute", "name"), RATES)
def test_rates_are_those_of_the_code(burst: str, a_minute: str, name: str) -> None:
    known = {**dataclasses.asdict(ClientRates()), "wire.rates.TokenGate.GUESSES": TokenGate.GUESSES}
    assert tuple(known[name]) == (int(burst.replace(",", "")), int(a_minute.replace(",", "")))


@pytest.mark.parametrize(("path", "name"), TESTS)
def test_tests_that_are_named_are_there(path: str, name: str) -> None:
    assert f"def {name}(" in (ROOT / path).read_text("utf-8") if name else (ROOT / path).is_file()


def test_each_promise_of_an_entrance_names_a_test() -> None:
    promises = [" ".join(text.split()) for text in re.split(r"^- ", part("Entrances"), flags=re.MULTILINE)[1:]]
    assert len(promises) > 20
    bare = [text for text in promises if not A_TEST.search(text) and not text.startswith(OPERATORS)]
    assert bare == []
    assert all(any(text.startswith(words) for text in promises) for words in OPERATORS)


@pytest.mark.parametrize("row", [*rows("Limits"), *rows("Attacks")])
def test_each_row_names_a_test(row: str) -> None:
    last = row.rsplit("|", 2)[1]
    assert A_TEST.search(last) or any(command in last or command in row for command in COMMANDS)


def test_the_tables_were_read() -> None:
    assert len(LIMITS) == len(rows("Limits"))
    assert len(RATES) == len(rows("Rates"))
    assert len(rows("Attacks")) > 50
    assert len(TESTS) > 30
