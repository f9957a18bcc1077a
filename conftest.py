"""With CHECK_SHAPES=1, annotated shapes and dtypes are checked while tests run, in whatever folder the run begins.

The check wraps every function of the packages, which makes small models up to twice as slow. `make test` therefore runs
all tests without it, and then a part of them with it (`SHAPED` in the Makefile).
"""

import os
from collections.abc import Iterator

import pytest

if os.environ.get("CHECK_SHAPES"):
    import tests.shapes  # noqa: F401  the hook looks its checker up by name
    from jaxtyping import install_import_hook

    install_import_hook(["echoavatar", "echoavatar_studio", "echoavatar_lab"], "tests.shapes.checked")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One more than processors for `-n auto`: tests that wait for servers and clocks leave them a sixth of the time."""
    return (os.cpu_count() or 1) + 1


@pytest.fixture(autouse=True)
def _torch_threads() -> Iterator[None]:
    """A command that sets torch's threads must not set those of the tests after it: two workers would spin in each
    other's way.
    """
    import torch

    before = torch.get_num_threads()
    yield
    if torch.get_num_threads() != before:
        torch.set_num_threads(before)
