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


def test_a_chunk_may_have_another_size() -> None:
    """The release's three tokens: 12 frames, 9,600 samples, 0.4 s; 1 s is two or three of them, and four of ours."""
    three = timing.ChunkSize(3)
    assert (three.frames, three.samples, three.seconds) == (12, 9_600, 0.4)
    assert (three.within(1.0), timing.CHUNK.within(1.0), three.within(0.0)) == (2, 4, 1)
    assert timing.ChunkSize.of(9_600) == three
    assert (timing.CHUNK.frames, timing.CHUNK.samples) == (timing.CHUNK_FRAMES, timing.CHUNK_SAMPLES)


@pytest.mark.parametrize("samples", [0, -3_200, 5_000])
def test_a_chunk_is_whole_tokens(samples: int) -> None:
    with pytest.raises(ValueError, match="multiple|one sample or more"):
        timing.ChunkSize.of(samples)
