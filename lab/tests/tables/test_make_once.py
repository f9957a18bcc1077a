from pathlib import Path

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar_lab.tables.make_once import make_once


def test_a_finished_part_is_kept_and_a_broken_one_made_again(tmp_path: Path) -> None:
    times = []

    def breaks() -> None:
        times.append("broken")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_once(tmp_path / "part", {"size": 1}, breaks)
    for _ in range(2):
        make_once(tmp_path / "part", {"size": 1}, lambda: times.append("whole"))
    assert times == ["broken", "whole"]


def test_a_part_of_other_settings_is_refused(tmp_path: Path) -> None:
    for _ in range(2):
        make_once(tmp_path / "part", {"size": (1, 2)}, lambda: None)
    with pytest.raises(EchoAvatarError, match="other settings"):
        make_once(tmp_path / "part", {"size": (1, 3)}, lambda: None)
