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
import functools
import hashlib
import inspect
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any

import numba
import numpy as np
from numba.core import caching, event
from numba.core.environment import Environment
from numba.core.runtime import rtsys

from echoavatar.cache import first_writable, user_caches

PACKAGE = Path(__file__).parents[1]
_LOAD_GLOBAL = dis.opmap["LOAD_GLOBAL"]
REORDERED = ("reassoc", "contract", "arcp", "nsz")  # sums may be reordered; infinities and NaN stay what they are


def kernel(*, reorders: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function; release the interpreter's lock while it runs, and keep the machine code between runs.

    `reorders` allows sums in any order and fused products, which is faster; the result then depends on the processor.
    `options` are those of `numba.njit`. A function must come after the kernels and constants that it uses. Raises
    NameError if the function uses a global name that is not defined yet.
    """
    if reorders:
        options["fastmath"] = set(REORDERED)

    def compile_lazily(function: Callable[..., Any]) -> Any:
        function = inspect.unwrap(function)
        digest = fingerprint(function, [(name, _in_order(options[name])) for name in sorted(options)])
        made = numba.njit(nogil=True, error_model="numpy", **options)(function)
        made.fingerprint, made._cache = digest, _Kept(function, digest)
        return made

    return compile_lazily


class _Kept(caching.FunctionCache):  # type: ignore[misc]
    """Numba's cache of one kernel in several folders: all are read, and the first writable one is written.

    Numba's own cache refuses to import a kernel where it cannot write. If files are damaged, the kernel is compiled.
    """

    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        self._name, self._py_func, self._digest = repr(function), function, digest
        self._within = Path(digest, caching._CacheLocator.get_suitable_cache_subpath(function.__code__.co_filename))
        self._impl = _Entries(function)
        self.enable()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for these types; None if no folder has it.

        Numba's own method also prepares the compiler, which takes a seventh of a second and is needed only to compile.
        """
        rtsys.initialize(target_context)  # arrays need it
        for folder in _folders():
            self._cache_file = self._file(folder)
            try:
                if (found := self._load_overload(sig, target_context)) is not None:
                    return found
            except Exception:  # damaged, unreadable, or an argument's class has moved since
                with suppress(OSError):
                    self._cache_file.flush()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        if self._impl.check_cachable(data):
            with suppress(OSError):
                (cache_folder() / self._within).mkdir(parents=True, exist_ok=True)
                self._file(cache_folder()).save(self._index_key(sig, data.codegen), self._impl.reduce(data))

    def _file(self, folder: Path) -> Any:
        name = f"{self._py_func.__name__}.py{sys.version_info[0]}{sys.version_info[1]}{getattr(sys, 'abiflags', '')}"
        return caching.IndexDataCacheFile(str(folder / self._within), name, self._digest)


class _Entries(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """How numba packs a compiled function; it does not look for a folder."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = SimpleNamespace(_py_file=function.__code__.co_filename)

    def reduce(self, compiled: Any) -> Any:
        """What is stored: numba's form, without the modules of library functions that were compiled into it.

        Numba would import those modules when it loads the code. Its linear algebra imports SciPy, which takes a fifth
        of a second, and machine code looks up no names in a module.
        """
        *packed, environments = super().reduce(compiled)
        return (*packed, tuple(_without_module(environment) for environment in environments))


def _without_module(environment: Any) -> Any:
    made = Environment({"__name__": "builtins"})
    made.consts[:], made.env_name = environment.consts, environment.env_name
    return made


def fingerprint(function: Callable[..., Any], options: object = None) -> str:
    """Hash of a function's instructions, of the constants it uses and of the kernels it calls, however deep.

    It reads byte code, because finding the source of a hundred kernels would take a quarter of a second at every start.

    Raises:
        NameError: it uses a global name that is not defined yet.
        TypeError: it uses something whose later changes could not be noticed.
    """
    parts = [repr(options), repr(function.__defaults__), _instructions(function.__code__)]
    for name in sorted(_global_names(function.__code__)):
        if name in function.__globals__:
            parts.append(f"{name} is {_content(name, function.__globals__[name])}")
        elif not hasattr(builtins, name):
            raise NameError(f"kernel {function.__name__} uses {name}, which must be defined before it")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@contextmanager
def compilations(first: Callable[[], object] = bool) -> Iterator[list[str]]:
    """A context that lists the functions compiled in it, by any thread; `first` is called before the first one.

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


@functools.cache
def cache_folder() -> Path:
    """Where compiled code is written: the first writable one of `_folders`, or a temporary one."""
    return first_writable(*_folders())


@functools.cache
def _folders() -> list[Path]:
    """Where compiled code may lie: in $NUMBA_CACHE_DIR, beside the package, in the user's cache."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    places = [PACKAGE / "__pycache__", *user_caches()]
    return [*([Path(named)] if named else []), *(place / "kernels" for place in places)]


def _in_order(option: object) -> object:
    """A set as a sorted list, because sets print in another order in every process, which would change the hash."""
    return sorted(option) if isinstance(option, set) else option


def _instructions(code: CodeType) -> str:
    constants = [_instructions(part) if isinstance(part, CodeType) else repr(part) for part in code.co_consts]
    return repr((code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars, code.co_argcount))


def _global_names(code: CodeType) -> set[str]:
    """The global names that the code loads, read from its bytes: `dis` takes ten times as long."""
    names, high = set[str](), 0
    for step, argument in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        argument += high
        high = argument << 8 if step == dis.EXTENDED_ARG else 0
        if step == _LOAD_GLOBAL:
            names.add(code.co_names[argument >> 1])
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
