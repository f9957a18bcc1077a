import pytest

from echoavatar import timing


def test_the_rates_agree_with_each_other() -> None:
    """One chunk is 8 frames, 2 motion tokens, 20 audio frames and 6,400 samples at once."""
    assert timing.SAMPLES_PER_FRAME == 800
    assert timing.CHUNK_SAMPLES == 6_400 == timing.MOTION_TOKENS_PER_CHUNK * timing.SAMPLES_PER_MOTION_TOKEN
    assert timing.AUDIO_FRAMES_PER_CHUNK * timing.SAMPLES_PER_AUDIO_TOKEN == timing.CHUNK_SAMPLES


def test_a_remainder_is_refused() -> None:
    with pytest.raises(ValueError, match="24000 is not a multiple of 44"):
        timing.exact_div(24_000, 44)
