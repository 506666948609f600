"""Functions that numba compiles from their own source: when they are compiled, and where the result is cached.

A hot formula is written in plain numbers. It runs as it stands, and compiled with the same bits: no fast math, no fused
products. Importing numba and reading its cache takes a second, compiling some ten: `CompiledFunction` is plain until
`prepare` or enough calls have made that worth it (docs/decisions/057-numba-dependency.md).
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, version
from inspect import isfunction
from pathlib import Path
from types import ModuleType
from typing import Any, Final
from zlib import crc32

from nclient.errors import VariableError

VARIABLE: Final = "NOMAD_COMPILED"
"""The environment variable: always, crowd (the default) or never."""

CROWD: Final = 50
"""So many robots, each ring read once a second, win back the loading of about a second within a minute."""

_FROM_ROBOTS: Final = {"always": 1.0, "crowd": float(CROWD), "never": float("inf")}

CALLS_BEFORE_LOADING: Final = 5000
"""After so many calls in plain Python, of some 0.1 ms, code on disk is loaded: they took as long as that will."""

_log = logging.getLogger(__name__)


def is_compiled_for(robots: int) -> bool:
    """Return True if NOMAD_COMPILED asks for compiled code with so many robots in this process.

    Raises
    ------
    VariableError
        The variable is set to an unknown word.
    """
    word = os.environ.get(VARIABLE, "crowd")
    if word not in _FROM_ROBOTS:
        raise VariableError(f"{VARIABLE} is {word!r}; it can be {', '.join(_FROM_ROBOTS)}")
    return robots >= _FROM_ROBOTS[word]


def checksum(*paths: str | None) -> int:
    """Return a checksum of source files: numba's cache watches one file only."""
    result = 0
    for path in (__file__, *paths):
        result = crc32(Path(str(path)).read_bytes(), result)
    return result


def mark_path(name: str, sources: int) -> Path:
    """Return the file that marks code with this checksum of its sources as compiled, in the folder of numba's cache.

    Raises
    ------
    PackageNotFoundError
        numba is not installed.
    """
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parent / "__pycache__")
    key = crc32(f"{_numba_version()} {sys.implementation.cache_tag}".encode(), sources)
    return folder / f"compiled.{name}.{key:08x}"


@cache
def _numba_version() -> str:
    """Return the installed version, or raise PackageNotFoundError. Cached: reading the metadata takes a millisecond."""
    return version("numba")


def write_mark(mark: Path) -> None:
    """Create a file that marks code as compiled, and its folder, which Python may not have made; not if read-only."""
    with suppress(OSError):
        mark.parent.mkdir(exist_ok=True)
        mark.touch()


def is_wanted(name: str, sources: int) -> bool:
    """Return True if compiled code is to be used: as NOMAD_COMPILED says, or where nothing waits for it unseen.

    By default it is used if it is on disk, or if stderr is a terminal, where progress is shown.

    Raises
    ------
    VariableError
        The variable is set to an unknown word.
    """
    if not is_compiled_for(CROWD):
        return False
    try:
        return mark_path(name, sources).exists() or is_compiled_for(1) or sys.stderr.isatty()
    except PackageNotFoundError:
        return False


def functions_of(*modules: ModuleType) -> list[Callable[..., Any]]:
    """Return the functions that stand in modules."""
    return [function for module in modules for function in vars(module).values() if isfunction(function)
            and function.__module__ == module.__name__]


def make_compilable(functions: Iterable[Callable[..., Any]]) -> None:
    """Let numba compile these functions where compiled code calls them. Raises ImportError without numba."""
    from numba.extending import register_jitable

    # Nothing calls them from C; without the wrappers for that, compiling is quicker.
    for function in functions:
        register_jitable(no_cfunc_wrapper=True)(function)


def compile_function(function: Callable[..., Any], *, is_division_tested: bool = True) -> Callable[..., Any]:
    """Return a function compiled by numba, when first called, or loaded from its cache.

    Without the test of each division for zero, a quotient by 0 is inf or NaN, as in arrays.
    """
    import numba

    options: dict[str, Any] = {"nogil": True, "error_model": "python" if is_division_tested else "numpy"}
    try:
        compiled: Callable[..., Any] = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no writable directory for the cache
        compiled = numba.njit(**options)(function)
    return compiled


class CompiledFunction:
    """A function of plain numbers that is compiled, once in a process, where that is worth it.

    Parameters
    ----------
    function
        The function, with plain Python types.
    sources
        The modules of what it calls.
    example
        Arguments of the types that compiled code is made for.
    """

    def __init__(self, function: Callable[..., Any], sources: Callable[[], Sequence[ModuleType]],
                 example: Callable[[], tuple[Any, ...]]) -> None:
        self.run = self._plain = function
        """The function, plain or compiled."""
        self.is_compiled = False
        """True if `run` is compiled: then it takes arrays for lists."""
        self._sources, self._example, self._calls = sources, example, 0

    def count_calls(self, calls: int = 1) -> None:
        """Load compiled code that is on disk after enough calls, unless `prepare` has decided."""
        before, self._calls = self._calls, self._calls + calls
        if before < CALLS_BEFORE_LOADING <= self._calls and self._is_on_disk():
            self.load()

    def prepare(self, is_used: bool) -> None:
        """Load or compile now if it is used and that is wanted, and never later: for programs with an event loop."""
        self._calls = CALLS_BEFORE_LOADING
        if is_used and not self.is_compiled and is_wanted(self._plain.__name__, self._checksum):
            self.load()

    def load(self) -> bool:
        """Load compiled code, or compile; return True if it is available, False without numba."""
        try:
            make_compilable({self._plain, *functions_of(*self._sources())})
        except ImportError:
            return False
        mark = mark_path(self._plain.__name__, self._checksum)
        if not mark.exists():
            _log.warning("compiling with numba; the result is cached function=%s", self._plain.__name__)
        compiled = compile_function(_with_checksum(self._plain, self._checksum))
        compiled(*self._example())
        write_mark(mark)
        self.run, self.is_compiled = compiled, True
        return True

    @cached_property
    def _checksum(self) -> int:
        return checksum(*(module.__file__ for module in self._sources()))

    def _is_on_disk(self) -> bool:
        try:
            return is_compiled_for(CROWD) and mark_path(self._plain.__name__, self._checksum).exists()
        except PackageNotFoundError:
            return False


def _with_checksum(function: Callable[..., Any], sources: int) -> Callable[..., Any]:
    """Return the function with a checksum as a variable of its closure, which is part of its key in numba's cache."""

    def entry(*arguments: Any) -> Any:
        assert sources >= 0
        return function(*arguments)

    return entry
