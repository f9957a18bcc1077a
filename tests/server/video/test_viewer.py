"""Twice the rate without delay; everything else of a viewer is seen from outside in `test_whep`."""

import numpy as np
import pytest

pytest.importorskip("aiortc", reason="pip install 'echoavatar[video]'")

from echoavatar.server.video.live_stream import BLOCK_SAMPLES, EDGE
from echoavatar.server.video.viewer import doubled


@pytest.mark.parametrize("hertz", [100, 1_000, 5_000, 9_000])
def test_a_tone_at_twice_the_rate_is_the_same_tone_at_the_same_time(hertz: float) -> None:
    moments = (np.arange(BLOCK_SAMPLES + 2 * EDGE) - EDGE) / 24_000
    samples = np.rint(10_000 * np.sin(2 * np.pi * hertz * moments)).astype(np.int16)
    wanted = 10_000 * np.sin(2 * np.pi * hertz * np.arange(2 * BLOCK_SAMPLES) / 48_000)
    assert np.abs(doubled(samples) - wanted).max() < 150


def test_the_loudest_sound_does_not_wrap_around() -> None:
    samples = np.where(np.arange(BLOCK_SAMPLES + 2 * EDGE) // 7 % 2, 32_767, -32_768).astype(np.int16)
    assert (np.sign(doubled(samples)[::2]) == np.sign(samples[EDGE:-EDGE])).all()
