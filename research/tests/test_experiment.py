from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.models.generator import TokenClip
from echoavatar_research.experiment import Experiment, is_mostly
from echoavatar_research.scale import PAPER


def test_the_papers_scale_wants_a_real_set(tmp_path: Path) -> None:
    with pytest.raises(EchoAvatarError, match="--corpus"):
        _ = Experiment(tmp_path, PAPER).corpus


def test_what_a_clip_is_mostly() -> None:
    domain = np.array([0, 1, 1, 2], np.uint8)
    clip = TokenClip(np.zeros((40, 2), int), np.zeros((4, 3, 2), int), domain)
    assert is_mostly(clip, None)
    assert is_mostly(clip, "speech")
    assert not is_mostly(clip, "music")
