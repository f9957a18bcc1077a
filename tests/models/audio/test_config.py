import pytest
from pydantic import ValidationError

from echoavatar.models.audio import CodecConfig


def test_ratios_that_break_the_clock_are_refused():
    with pytest.raises(ValidationError, match="product of ratios is 160, wanted 320"):
        CodecConfig(ratios=(8, 5, 4))


def test_codebook_sizes_that_are_no_powers_of_two_are_refused():
    with pytest.raises(ValidationError, match="power of two"):
        CodecConfig(codes=500)


def test_config_survives_json():
    config = CodecConfig(filters=4, padding="reflect")
    assert CodecConfig.model_validate_json(config.model_dump_json()) == config
