from pathlib import Path

import numpy as np
import pytest
import soundfile

from echoavatar.agents.client import read_sound
from echoavatar.errors import AudioError


def test_two_channels_become_one_at_their_own_rate(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "a.wav", np.array([[0.5, 0.0], [0.0, 0.25]]), 44_100)
    samples, rate = read_sound(tmp_path / "a.wav")
    np.testing.assert_allclose(samples, [0.25, 0.125], atol=1e-4)
    assert rate == 44_100


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.wav").write_text("no")
    with pytest.raises(AudioError, match=r"a\.wav"):
        read_sound(tmp_path / "a.wav")
    with pytest.raises(AudioError):
        read_sound(tmp_path / "none.wav")
    soundfile.write(tmp_path / "b.wav", np.zeros(0), 24_000)
    with pytest.raises(AudioError, match="no sound"):
        read_sound(tmp_path / "b.wav")
