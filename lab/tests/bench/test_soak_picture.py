from pathlib import Path

import pytest

from echoavatar.cli import main
from echoavatar.errors import EchoAvatarError
from echoavatar_lab.bench.soak_picture import read_report

REPORT = '{"memory_mb": [[0, 700.0], [60, 800.0], [120, 801.0]], "slope_mb_an_hour": 60.0, "turns": 7}'


def test_what_a_soak_printed_is_drawn(tmp_path: Path) -> None:
    (tmp_path / "churn.txt").write_text(f"frames 12\nthe sessions stayed whole\n{REPORT}\n")
    picture = tmp_path / "churn.png"
    assert main(["bench", "soak", "--of", str(tmp_path / "churn.txt"), "--picture", str(picture)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("text", ["", "killed", "{}", "[1]", "7"])
def test_what_is_no_report_is_said(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(EchoAvatarError, match="does not end with a report"):
        read_report(tmp_path / "a.txt")
