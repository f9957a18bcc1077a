from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.generator import TokenClip
from echoavatar.reproduce.scale import PAPER, TINY
from echoavatar.reproduce.workshop import Workshop, is_mostly


def test_a_finished_part_is_kept_and_a_broken_one_made_again(tmp_path: Path) -> None:
    workshop, times = Workshop(tmp_path, TINY), []

    def breaks() -> None:
        times.append("broken")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        workshop._kept(tmp_path / "part", {"size": 1}, breaks)
    for _ in range(2):
        workshop._kept(tmp_path / "part", {"size": 1}, lambda: times.append("whole"))
    assert times == ["broken", "whole"]


def test_a_part_of_other_settings_is_refused(tmp_path: Path) -> None:
    workshop = Workshop(tmp_path, TINY)
    workshop._kept(tmp_path / "part", {"size": (1, 2)}, lambda: None)
    workshop._kept(tmp_path / "part", {"size": (1, 2)}, lambda: None)
    with pytest.raises(EchoAvatarError, match="other settings"):
        workshop._kept(tmp_path / "part", {"size": (1, 3)}, lambda: None)


def test_the_papers_scale_wants_a_real_set(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="--corpus"):
        _ = Workshop(tmp_path, PAPER).corpus


def test_what_a_clip_is_mostly() -> None:
    domain = np.array([0, 1, 1, 2], np.uint8)
    clip = TokenClip(np.zeros((40, 2), int), np.zeros((4, 3, 2), int), domain)
    assert is_mostly(clip, None)
    assert is_mostly(clip, "speech")
    assert not is_mostly(clip, "music")
