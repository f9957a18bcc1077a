from pathlib import Path

import numpy as np
import pytest

from echoavatar.errors import MotionError
from echoavatar.models.face.export import write_live_link
from echoavatar_lab.models.face.clip import read_live_link


def curves(frames: int) -> np.ndarray:
    return np.random.default_rng(0).random((frames, 52)).astype(np.float32)


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_a_take_reads_back(tmp_path: Path, fps: float) -> None:
    """At 60 fps the reader keeps every second frame; frames past a full second carry over into the seconds."""
    written = curves(70)
    write_live_link(tmp_path / "take.csv", written, fps)
    take = read_live_link(tmp_path / "take.csv")
    assert take.rate_hz == pytest.approx(fps, rel=1e-3)
    np.testing.assert_allclose(take.curves, written[:: round(fps / 30)], atol=2e-3)


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="choose another place"):
        write_live_link(tmp_path / "no" / "take.csv", curves(3))
