import pytest
from pydantic import ValidationError

from echoavatar.config import Config


class Small(Config):
    width: int = 4


def test_unknown_keys_are_errors() -> None:
    with pytest.raises(ValidationError, match="widht"):
        Small.model_validate({"widht": 8})
