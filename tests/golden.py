"""Arrays that other implementations computed: those shipped with the tests, or else those of the authors' checkout."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SHIPPED = Path(__file__).parent / "fixtures/golden"
SHARED = Path(__file__).parents[2] / "shared/golden"


def golden(name: str) -> Path:
    """The file of that name, such as `reference_release/ik.npz`; the test is skipped where it is not."""
    for folder in (SHIPPED, SHARED):
        if (folder / name).exists():
            return folder / name
    return pytest.skip(f"needs ../shared/golden/{name}, which only a checkout with the authors' arrays has")


class Arrays(dict[str, np.ndarray]):
    """Arrays by name; a test that asks for one that is not here is skipped."""

    def __missing__(self, name: str) -> Any:
        pytest.skip(f"needs the array {name} of ../shared/golden, which only a checkout with the authors' arrays has")


@lru_cache
def metric_inputs() -> Arrays:
    """Synthetic sound, motion and features: the shipped part, and the rest where it is."""
    found = Arrays(np.load(SHIPPED / "metrics/synthetic.npz"))
    return Arrays({**np.load(whole), **found}) if (whole := SHARED / "metrics/inputs.npz").exists() else found
