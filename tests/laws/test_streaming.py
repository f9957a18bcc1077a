"""Every streaming class of the package keeps the five laws; one that has no case fails here."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType

import pytest
import torch
from tests.laws.cases import CASES, COVERED, Case
from tests.laws.streaming import hold

from echoavatar_lab.nn.blocks import CausalBlock

ROOMS = (
    *(f"echoavatar.{room}" for room in ("nn", "motion", "models", "engine")),
    *(f"echoavatar_lab.{room}" for room in ("nn", "models")),
)
ELSEWHERE = "echoavatar_lab.models.tokenizer.variants"  # its own test holds them to the laws
NAMED = {f"{owner.__name__} {name}".strip(): case for owner, cases in CASES.items() for name, case in cases.items()}
SLOW = {"ExportedStep of a codec", "ExportedStep of a decoder"}  # an ear is exported in each run


def modules() -> Iterator[ModuleType]:
    for room in ROOMS:
        package = importlib.import_module(room)
        yield package
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if found.name != ELSEWHERE:
                yield importlib.import_module(found.name)


def streaming_classes(module: ModuleType) -> set[type]:
    """Those defined in the module that make a state for some rows; not those that leave their step to subclasses."""

    def makes_states(owner: type) -> bool:
        makers = (member for name, member in inspect.getmembers(owner, callable) if name.startswith("init_"))
        return any("rows" in inspect.signature(maker).parameters for maker in makers)

    return {
        owner
        for _, owner in inspect.getmembers(module, inspect.isclass)
        if owner.__module__ == module.__name__ and makes_states(owner) and not inspect.isabstract(owner)
    }


def without_case(found: set[type]) -> str:
    """What to do about the classes that nobody holds to the laws; empty if there is none."""
    missing = sorted(f"{owner.__module__}.{owner.__name__}" for owner in found - CASES.keys() - COVERED.keys())
    if not missing:
        return ""
    return (
        f"{', '.join(missing)}: add a case to CASES in tests/laws/cases.py, or, if a larger class's case runs it, "
        "an entry to COVERED that says so"
    )


def test_no_streaming_class_is_without_a_case() -> None:
    found = set[type]().union(*map(streaming_classes, modules()))
    assert not without_case(found)
    assert CASES.keys() | COVERED.keys() == found, "tests/laws/cases.py lists classes that are not there"
    assert all(owner in CASES for owner, _ in COVERED.values())


def test_a_new_streaming_class_is_noticed() -> None:
    class Forgotten(CausalBlock):
        pass

    module = ModuleType("echoavatar.nn.new")
    Forgotten.__module__, module.Forgotten = module.__name__, Forgotten
    assert streaming_classes(module) == {Forgotten}
    assert "echoavatar.nn.new.Forgotten: add a case to CASES" in without_case({Forgotten, CausalBlock})


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=name, marks=[pytest.mark.slow] if name in SLOW else []) for name, case in NAMED.items()],
)
@torch.no_grad()
def test_the_five_laws_hold(case: Case) -> None:
    hold(case.stream(), case.make, unit=case.unit, cuts=case.cuts, atol=case.atol)
