"""When functions are compiled: on request, before an event loop, or after enough calls."""

from __future__ import annotations

import builtins
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from worlds import geometry
from worlds.compiled import CALLS_BEFORE_LOADING, VARIABLE, CompiledFunction, mark_path


def double(x: float) -> float:
    return 2.0 * x


class Loadable(CompiledFunction):
    """A function that counts how often it is loaded."""

    loads = 0

    def load(self) -> bool:
        self.loads += 1
        return True


def sources() -> list[ModuleType]:
    return [geometry]


@pytest.fixture
def function(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Loadable:
    """Return a function that is not compiled, with an empty cache, where compiling is permitted."""
    pytest.importorskip("numba")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv(VARIABLE, "crowd")
    return Loadable(double, sources, lambda: (1.0,))


def mark(function: CompiledFunction) -> None:
    """Mark a function as compiled and on disk."""
    mark_path("double", function._checksum).touch()


@pytest.mark.parametrize("is_on_disk", [False, True])
def test_enough_calls_load_what_is_on_disk(function: Loadable, is_on_disk: bool) -> None:
    if is_on_disk:
        mark(function)
    for _ in range(CALLS_BEFORE_LOADING - 1):
        function.count_calls()
    # Below this number of calls the interpreted function is faster than loading the compiled one.
    assert function.loads == 0
    for _ in range(CALLS_BEFORE_LOADING):
        function.count_calls()
    # Loading later compiles nothing: only what an earlier run has stored is loaded.
    assert function.loads == is_on_disk


@pytest.mark.long
@pytest.mark.parametrize(("is_used", "is_on_disk", "loads"), [(True, True, 1), (True, False, 0), (False, True, 0)])
def test_an_event_loop_never_loads_later(function: Loadable, is_used: bool, is_on_disk: bool, loads: int) -> None:
    if is_on_disk:
        mark(function)
    function.prepare(is_used)
    # Compiling takes seconds, during which an event loop would not serve its clients.
    for _ in range(2 * CALLS_BEFORE_LOADING):
        function.count_calls()
    assert function.loads == loads


def test_the_variable_forbids_or_demands_compiling(function: Loadable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "always")
    function.prepare(True)
    assert function.loads == 1
    mark(function)
    monkeypatch.setenv(VARIABLE, "never")
    function.prepare(True)
    for _ in range(2 * CALLS_BEFORE_LOADING):
        function.count_calls()
    assert function.loads == 1


@pytest.mark.long
def test_a_compiled_function_is_marked_and_gives_the_same(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("numba")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    # The second function finds the first one's code on disk: no second message.
    for times in (1, 1):
        function = CompiledFunction(double, sources, lambda: (1.0,))
        assert function.load()
        assert function.is_compiled
        assert function.run(0.1) == double(0.1)
        assert mark_path("double", function._checksum).exists()
        assert caplog.text.count("compiling with numba") == times


def test_without_numba_a_function_stays_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name.startswith("numba"):
            raise ImportError(name)
        return found(name, *rest, **more)

    # As if numba were not installed.
    monkeypatch.setattr(builtins, "__import__", without)
    function = CompiledFunction(double, sources, lambda: (1.0,))
    assert not function.load()
    assert function.run is double
