from pathlib import Path

from echoavatar.cli import main

REPORT = '{"memory_mb": [[0, 700.0], [60, 800.0], [120, 801.0]], "slope_mb_an_hour": 60.0, "turns": 7}'


def test_what_a_soak_printed_is_drawn(tmp_path: Path) -> None:
    (tmp_path / "churn.txt").write_text(f"frames 12\nthe sessions stayed whole\n{REPORT}\n")
    picture = tmp_path / "churn.png"
    assert main(["bench", "soak", "--of", str(tmp_path / "churn.txt"), "--picture", str(picture)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
