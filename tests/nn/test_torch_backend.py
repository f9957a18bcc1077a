"""The door to the lab."""

import sys

import pytest

from echoavatar.errors import DependencyError
from echoavatar.nn.torch_backend import torch_backend


@pytest.mark.parametrize("absent", ["echoavatar_lab", "torch"])
def test_without_the_lab_one_line_says_how_to_get_it(absent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "echoavatar_lab"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, absent, None)
    with pytest.raises(DependencyError, match=r"a GPU needs torch, .* pip install ./lab$") as caught:
        torch_backend("a GPU")
    assert "\n" not in str(caught.value)


def test_a_fault_inside_the_lab_is_not_called_its_absence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "echoavatar_lab.torch_backend", raising=False)
    monkeypatch.setitem(sys.modules, "echoavatar_lab.models.face.model", None)
    with pytest.raises(ModuleNotFoundError, match="face"):
        torch_backend("a GPU")
