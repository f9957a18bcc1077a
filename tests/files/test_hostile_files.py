"""No small file takes more than 300 MB or 5 s, whatever it asks for, nor ends a command in a traceback."""

import json
import subprocess
import sys

import pytest
from tests.files.hostile_files import FILES, Row

MOST_MB, MOST_S = 300, 5
SLOW = {name for name, file in FILES.items() if file.is_slow}
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


@pytest.fixture(scope="module")
def quick() -> dict[str, Row]:
    return table([name for name in FILES if name not in SLOW])


@pytest.fixture(scope="module")
def slow() -> dict[str, Row]:
    return table([name for name in FILES if name in SLOW])


def table(names: list[str]) -> dict[str, Row]:
    """Each file's row, measured in the children of a process of its own."""
    command = [sys.executable, "-m", "tests.files.hostile_files", "--json", *names]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=900)
    rows = [Row(*json.loads(line)) for line in done.stdout.splitlines()]
    return {row.name: row for row in rows}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in FILES]
)
def test_a_small_file_takes_little_memory_and_time(name: str, request: pytest.FixtureRequest) -> None:
    row: Row = request.getfixturevalue("slow" if name in SLOW else "quick")[name]
    assert row.outcome in ("read", "refused"), row.said
    assert row.peak_mb < MOST_MB
    assert row.seconds < MOST_S
    assert "Traceback" not in row.said
    assert all(letter.isprintable() or letter == "\n" for letter in row.said), "nothing steers a terminal"
    if row.outcome == "refused":
        assert len(row.said) < 2_000
