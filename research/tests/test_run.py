from pathlib import Path

import pytest
from research.tests.test_text import TABLE

from echoavatar_research.run import hardware, write


def test_a_table_is_written_four_ways(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    paths = write(TABLE, tmp_path / "new")
    assert [path.suffix for path in paths] == [".md", ".csv", ".tex", ".png"]
    assert all(path.stat().st_size > 50 for path in paths)


def test_hardware_is_named() -> None:
    assert "cores" in hardware("cpu")
