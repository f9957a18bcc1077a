import numpy as np
import pytest
from tests.agents.integrations.fakes import tone

from echoavatar.agents.integrations.resampler import SpeechResampler


@pytest.mark.parametrize("rate", [8_000, 16_000, 24_000, 44_100, 48_000])
def test_blocks_make_one_sound_at_our_rate(rate: int) -> None:
    stream = SpeechResampler()
    parts = [stream.push(block, rate) for block in np.array_split(tone(1.0, rate), 9)]
    made = np.concatenate([*parts, stream.flush()])
    assert abs(len(made) - 24_000) <= 1
    np.testing.assert_allclose(made[1_000:23_000], tone(1.0, 24_000)[1_000:23_000], atol=60)


def test_after_a_reset_nothing_old_is_left() -> None:
    stream = SpeechResampler()
    stream.push(tone(0.5, 16_000), 16_000)
    stream.reset()
    made = np.concatenate([stream.push(np.zeros(1_600, np.int16), 16_000), stream.flush()])
    assert np.abs(made).max() <= 1  # soxr dithers


def test_the_rate_may_change() -> None:
    stream = SpeechResampler()
    stream.push(tone(0.1, 16_000), 16_000)
    assert len(stream.push(tone(0.1, 24_000), 24_000)) == 2_400
