"""Every module of the lab loads in the environment at hand."""

import importlib
import pkgutil

import pytest

import echoavatar_lab

MODULES = [module.name for module in pkgutil.walk_packages(echoavatar_lab.__path__, "echoavatar_lab.")]


@pytest.mark.parametrize("name", MODULES)
def test_it_loads(name: str) -> None:
    importlib.import_module(name)
