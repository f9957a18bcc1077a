from pathlib import Path

import pytest
from research.tests.test_text import TABLE

from echoavatar_research.figure import draw


def test_a_picture_has_a_panel_for_each_column_of_ours(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw(TABLE, tmp_path / "t.svg")
    text = (tmp_path / "t.svg").read_text()
    assert all(said in text for said in ("FID", "Time (ms)", "paper", "a_b"))
