from pathlib import Path

import pytest

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar_lab.evaluation.metrics.bootstrap import Interval
from echoavatar_lab.evaluation.score_picture import draw
from echoavatar_lab.evaluation.score_row import Row

pytest.importorskip("matplotlib", reason="the evaluate extra is not installed")
ROWS = [
    Row("fid", "", 12.0, Interval(10.0, 15.0), truth=2.0),
    Row("ba_g_sharp", "", 0.4, Interval(0.3, 0.5), 0.35, 0.05, Interval(0.0, 0.1), 0.45, 0.33),
    Row("nothing", "m", float("nan")),
]


def test_a_picture_is_written_as_high_as_it_has_rows(tmp_path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    for count in (1, 3):
        draw(ROWS[:count], tmp_path / f"{count}.png", title="made against true")
    few, many = (pillow.open(tmp_path / f"{count}.png") for count in (1, 3))
    assert many.height > few.height
    assert len(many.convert("RGB").getcolors(100_000)) > 20


def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(ROWS, tmp_path / "none" / "a.png", title="")
    with pytest.raises(EchoAvatarError, match="cannot write"):
        draw(ROWS, tmp_path / "a.nonsense", title="")


def test_without_matplotlib_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    with pytest.raises(DependencyError, match="evaluate"):
        draw(ROWS, tmp_path / "a.png", title="")
