"""Settings whose ratios do not give the clock of the codes are refused by name."""

import pytest

from echoavatar.models.audio import CodecConfig


def test_ratios_give_75_codes_a_second() -> None:
    assert CodecConfig().ratios
    with pytest.raises(ValueError, match="ratios"):
        CodecConfig(ratios=(2, 2))
