"""What a test run checks of annotations: shapes and dtypes of arrays. Plain types are mypy's, so fakes stay plain."""

from collections.abc import Callable
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])
CONFIG = BeartypeConf(is_pep484_tower=True)


def checked(function: FunctionT) -> FunctionT:
    """The function, with those of its annotations checked in each call that are arrays, or unions or tuples of some.

    Arrays in lists and other containers may differ in length, though their annotation names one axis for all.
    """
    shapes = {name: hint for name, hint in function.__annotations__.items() if _is_checked(hint)}
    function.__annotations__ = shapes
    return beartype(function, conf=CONFIG) if shapes else function


def _is_checked(hint: Any) -> bool:
    if get_origin(hint) in (Union, UnionType, tuple):
        return ... not in get_args(hint) and any(map(_is_checked, get_args(hint)))
    return isinstance(hint, type) and issubclass(hint, AbstractArray)
