"""Compiled loops (numba) whose cache notices every edit.

Numba keeps compiled code between runs and compiles anew when the file of the called function changes. It does not look
at the functions and constants that the function takes from elsewhere: after an edit there, it would run the old code.
`kernel` therefore gives each function a cache folder named after everything the function is made of.

    @kernel()
    def squared(x):
        return x * x

    @kernel()
    def distance(a, b):  # an edit of `squared`, in whatever file, compiles `distance` anew
        return np.sqrt(squared(a[0] - b[0]) + squared(a[1] - b[1]))

The first call on a machine compiles, which takes seconds for a large kernel.
"""

import builtins
import dis
import hashlib
import inspect
import os
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core import event

PACKAGE = Path(__file__).parents[1]
REORDERED = ("reassoc", "contract", "arcp", "nsz")  # sums may be reordered; infinities and NaN stay what they are


def kernel(*, reorders: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function; release the interpreter's lock while it runs, and keep the machine code between runs.

    `reorders` allows sums in any order and fused products, which is faster; the result then depends on the processor.
    `options` are those of `numba.njit`. A function must come after the kernels and constants that it uses.

    Raises:
        NameError: the function uses a global name that is not defined yet.
    """
    if reorders:
        options["fastmath"] = set(REORDERED)

    def compile_lazily(function: Callable[..., Any]) -> Any:
        function = inspect.unwrap(function)
        digest = fingerprint(function, [(name, _in_order(options[name])) for name in sorted(options)])
        folder, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(cache_folder() / digest)
        try:
            made = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
        finally:
            numba.config.CACHE_DIR = folder
        made.fingerprint = digest
        _forget_the_unreadable(made._cache)
        return made

    return compile_lazily


def _forget_the_unreadable(cache: Any) -> None:
    """Compile anew where a cache's entries name the class of an argument that has since moved to another module."""
    load = cache.load_overload

    def loaded(*asked: Any) -> Any:
        try:
            return load(*asked)
        except (ImportError, AttributeError):
            cache.flush()
            return None

    cache.load_overload = loaded


def fingerprint(function: Callable[..., Any], options: object = None) -> str:
    """Hash of a function's source, of the constants it uses and of the kernels it calls, however deep.

    Raises:
        NameError: it uses a global name that is not defined yet.
        TypeError: it uses something whose later changes could not be noticed.
    """
    parts = [repr(options), textwrap.dedent(inspect.getsource(function))]
    for name in sorted(_global_names(function.__code__)):
        if name in function.__globals__:
            parts.append(f"{name} is {_content(name, function.__globals__[name])}")
        elif not hasattr(builtins, name):
            raise NameError(f"kernel {function.__name__} uses {name}, which must be defined before it")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@contextmanager
def compilations(first: Callable[[], object] = bool) -> Iterator[list[str]]:
    """The names of the functions that are compiled meanwhile, in any thread; `first` is called before the first.

    Functions whose machine code is in the cache are not compiled.
    """

    class Compiled(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            if not names:
                first()
            names.append(event.data["dispatcher"].__name__)

        def on_end(self, event: Any) -> None:
            pass

    names, listener = list[str](), Compiled()
    event.register("numba:compile", listener)
    try:
        yield names
    finally:
        event.unregister("numba:compile", listener)


def cache_folder() -> Path:
    """Beside the package, or in the user's cache where the package cannot be written."""
    beside = PACKAGE / "__pycache__"
    if os.access(beside if beside.exists() else PACKAGE, os.W_OK):
        return beside / "kernels"
    return user_cache() / "kernels"


def user_cache() -> Path:
    """The package's folder in the user's cache."""
    base = os.environ.get("XDG_CACHE_HOME") or ("~/Library/Caches" if sys.platform == "darwin" else "~/.cache")
    return Path(base).expanduser() / "echoavatar"


def _in_order(option: object) -> object:
    """Sets print in another order in every process, and the cache would never be found again."""
    return sorted(option) if isinstance(option, set) else option


def _global_names(code: CodeType) -> set[str]:
    names = {step.argval for step in dis.get_instructions(code) if step.opname == "LOAD_GLOBAL"}
    return names.union(*(_global_names(part) for part in code.co_consts if isinstance(part, CodeType)))


def _content(name: str, value: object) -> str:
    if hasattr(value, "fingerprint"):
        return str(value.fingerprint)
    if isinstance(value, ModuleType) or getattr(value, "__module__", "").split(".")[0] == "numba":
        return f"{getattr(value, '__name__', name)} of a library"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, (bool, int, float, str, tuple, np.generic, type)):
        return repr(value)
    raise TypeError(f"a kernel uses {name}, a {type(value).__name__}; it may use kernels, numbers, arrays and tuples")
