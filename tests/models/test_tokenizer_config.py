"""Settings of a tokenizer that cannot be built are refused by name."""

import pytest

from echoavatar.models.tokenizer_config import MotionTokenizerConfig


def test_heads_divide_the_width() -> None:
    with pytest.raises(ValueError, match="heads"):
        MotionTokenizerConfig(features=9, width=10, heads=3)
