"""Tables of pandas out of a pickle, without pandas and without running the pickle.

A data frame is pickled as blocks: arrays of (columns, rows), each with the places of its columns, and two indices, of
columns and of rows. `pickled_arrays` notes these objects; here the columns are put together by name. The index of rows
is not read. Known are pandas 1.3 to 3, and the older form, whose blocks lie in the manager's state.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from .pickled_arrays import PickledArray, PickledObject, RefusedError

NOTED = (
    "pandas DataFrame",
    "pandas Index",
    "pandas StringDtype",
    "pandas RangeIndex",
    "pandas TimedeltaIndex",
    "pandas.arrays StringArray",
    "pandas.arrays TimedeltaArray",
    "pandas.core.frame DataFrame",
    "pandas.core.internals.managers BlockManager",
    "pandas._libs.internals _unpickle_block",
    "pandas._libs.arrays __pyx_unpickle_NDArrayBacked",
    "pandas.core.indexes.base Index",
    "pandas.core.indexes.base _new_Index",
    "pandas.core.indexes.range RangeIndex",
    "pandas.core.indexes.timedeltas TimedeltaIndex",
    "pandas.core.indexes.timedeltas _new_TimedeltaIndex",
    "pandas.core.arrays.timedeltas TimedeltaArray",
    "builtins slice",
    "__builtin__ slice",
)
"""What a pickled data frame of numbers names; nothing of it is imported or called."""
_OLD = "0.14.1"  # the key of the older form


def frame_columns(stored: Any) -> dict[str, np.ndarray]:
    """The columns of a data frame by name, each (rows,).

    Raises:
        RefusedError: it is no data frame of numbers, or its columns do not fit its blocks.
    """
    if not isinstance(stored, PickledObject) or not stored.name.endswith(" DataFrame"):
        raise RefusedError("it holds no data frame")
    state = stored.state if isinstance(stored.state, dict) else {}
    manager = state.get("_mgr", state.get("_data"))
    if not isinstance(manager, PickledObject) or not manager.name.endswith(" BlockManager"):
        raise RefusedError("it holds a data frame without blocks")
    try:
        axes, blocks = _new_form(manager) if manager.arguments else _old_form(manager)
        names = _names(axes[0])
        found: list[np.ndarray | None] = [None] * len(names)
        for values, places in blocks:
            for place, row in zip(_places(places), _content(values), strict=True):
                found[place] = row
    except (TypeError, ValueError, IndexError, KeyError, AttributeError) as error:
        raise RefusedError(f"it holds a data frame of a form that is not known ({error})") from error
    if any(column is None for column in found) or len({len(column) for column in found if column is not None}) > 1:
        raise RefusedError("it holds a data frame whose columns do not fit its blocks")
    return {name: column for name, column in zip(names, found, strict=True) if column is not None}


def _new_form(manager: PickledObject) -> tuple[list[Any], list[tuple[Any, Any]]]:
    blocks, axes = manager.arguments[:2]
    return axes, [block.arguments[:2] for block in blocks]


def _old_form(manager: PickledObject) -> tuple[list[Any], list[tuple[Any, Any]]]:
    kept = manager.state[3][_OLD]
    return kept["axes"], [(block["values"], block["mgr_locs"]) for block in kept["blocks"]]


def _names(index: PickledObject) -> list[str]:
    """The texts of an index; newer pandas wraps their array once more."""
    data = index.arguments[1]["data"]
    if isinstance(data, PickledObject):
        data = next(part for part in data.state if isinstance(part, PickledArray))
    if not isinstance(data.content, list) or not all(isinstance(name, str) for name in data.content):
        raise RefusedError("it holds a data frame whose columns have no names")
    return data.content


def _places(places: Any) -> Iterator[int]:
    if isinstance(places, PickledArray):
        return (int(place) for place in _content(places))
    start, stop, step = places.arguments
    return iter(range(start, stop, step or 1))


def _content(array: PickledArray) -> np.ndarray:
    if not isinstance(array.content, np.ndarray):
        raise RefusedError("it holds a data frame of something else than numbers")
    return array.content
