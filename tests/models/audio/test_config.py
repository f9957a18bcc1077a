import pytest
from pydantic import ValidationError

from echoavatar.models.audio import CodecConfig


def test_ratios_that_break_the_clock_and_odd_codebook_sizes_are_refused():
    with pytest.raises(ValidationError, match="product of ratios is 160, wanted 320"):
        CodecConfig(ratios=(8, 5, 4))
    with pytest.raises(ValidationError, match="power of two"):
        CodecConfig(codes=500)
