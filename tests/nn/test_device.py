"""Where models run."""

import sys

import pytest
import torch

from echoavatar.errors import DependencyError, EchoAvatarError
from echoavatar.nn.device import find_device, threads


def test_a_person_says_where() -> None:
    assert find_device("cpu") == "cpu"
    assert find_device("auto") == ("cuda" if torch.cuda.is_available() else "cpu")
    for word in ("gpu", "cuda:first", "cuda:", "cpu:1"):
        with pytest.raises(EchoAvatarError, match="say cpu, cuda"):
            find_device(word)


def test_without_the_lab_there_is_the_processor_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "echoavatar_lab", None)
    monkeypatch.delitem(sys.modules, "echoavatar_lab.torch_backend", raising=False)
    assert find_device("cpu") == find_device("auto") == "cpu"
    with pytest.raises(DependencyError, match="a GPU needs torch, .* pip install ./lab"):
        find_device("cuda")


def test_threads_are_as_many_as_the_system_says_or_as_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert threads() == 3
    for nothing in ("", "0", "two"):
        monkeypatch.setenv("OMP_NUM_THREADS", nothing)
        assert threads() >= 1
