import pytest
from pydantic import ValidationError

from echoavatar.models.fingers import FingerConfig


@pytest.mark.parametrize("sizes", [{"frames": 30, "patch": 4}, {"width": 36, "heads": 4}, {"poses": 91}])
def test_sizes_that_do_not_fit_are_refused(sizes: dict[str, int]) -> None:
    with pytest.raises(ValidationError, match="must|less than"):
        FingerConfig(**sizes)


def test_unknown_fields_are_refused() -> None:
    with pytest.raises(ValidationError, match="diffusion"):
        FingerConfig(diffusion=True)  # type: ignore[call-arg]
