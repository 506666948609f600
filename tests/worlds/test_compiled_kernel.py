"""The compiled kernel against arrays, bit for bit, and the conditions for loading it."""

from __future__ import annotations

import builtins
import sys
from math import cos, inf, sin
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nclient.errors import VariableError
from worlds import raycast
from worlds.compiled import CROWD, VARIABLE
from worlds.geometry import FloatArray, polygon_segments
from worlds.raycast import CompiledKernel, cast_discs, cast_ray, load_compiled

MAX_RANGE_IN = 500.0
WHOLE = st.integers(-6, 6).map(float)
"""Whole numbers let corners, ends and starts fall on rays exactly, where the branches are."""
COORDINATE = WHOLE | st.floats(-300.0, 300.0)
WALLS = st.lists(st.tuples(*[COORDINATE] * 4), max_size=8).map(lambda rows: np.array(rows).reshape(-1, 4))
DISCS = st.lists(st.tuples(COORDINATE, COORDINATE, st.floats(1.0, 20.0)), max_size=6)
DIRECTION = st.sampled_from([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]) | st.floats(0.0, 6.3).map(
    lambda angle: (cos(angle), sin(angle))
)
SQUARE = polygon_segments([(0, 0), (6, 0), (6, 6), (0, 6)])


@pytest.fixture(scope="module")
def kernel() -> CompiledKernel:
    """Machine code, of this module alone."""
    pytest.importorskip("numba")
    loaded = CompiledKernel()
    assert loaded.load()
    return loaded


def by_x(discs: list[tuple[float, float, float]]) -> FloatArray:
    rows = np.array(discs).reshape(-1, 3)
    order = rows[:, 0].argsort(kind="stable")
    return np.column_stack((rows[order], order))


@given(st.tuples(COORDINATE, COORDINATE), DIRECTION, WALLS, DISCS, st.integers(0, 6))
@example((0.0, 0.0), (1.0, 0.0), SQUARE, [], 0)
@example((3.0, 3.0), (0.0, 1.0), SQUARE, [(3.0, 5.0, 1.0), (3.0, 3.0, 8.0)], 1)
@example((0.0, 0.0), (1.0, 0.0), np.zeros((0, 4)), [(-400.0, 0.0, 5.0), (9.0, 0.0, 5.0), (600.0, 0.0, 5.0)], 1)
@example((0.0, 0.0), (1.0, 0.0), np.zeros((0, 4)), [(600.0, 0.0, 5.0), (-600.0, 0.0, 20.0)], 6)
def test_compiled_scalar_and_array_results_are_equal(
    kernel: CompiledKernel,
    place: tuple[float, float],
    direction: tuple[float, float],
    walls: FloatArray,
    discs: list[tuple[float, float, float]],
    own: int,
) -> None:
    assert kernel.run is not None
    robots = by_x(discs)
    handed = *place, *direction, walls, robots, own, 20.0, MAX_RANGE_IN
    found, in_numbers = kernel.run(*handed), float(raycast.nearest_obstacle(*handed))
    in_reach = np.abs(robots[:, 0] - place[0]) <= MAX_RANGE_IN
    to_disc = float(cast_discs(place, direction, robots[(robots[:, 3] != own) & in_reach, :3]))
    to_wall = cast_ray(*place, *direction, walls)[0] if len(walls) else inf
    assert found.hex() == in_numbers.hex() == min(to_wall, to_disc).hex()


@pytest.mark.long
def test_writable_and_read_only_arrays_use_the_same_code(kernel: CompiledKernel) -> None:
    assert kernel.run is not None
    fixed = SQUARE.copy()
    fixed.setflags(write=False)
    no_robots = np.zeros((0, 4))
    for walls in (SQUARE.copy(), fixed):
        assert kernel.run(2.0, 3.0, 1.0, 0.0, walls, no_robots, 0, 0.0, MAX_RANGE_IN) == 4.0


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> CompiledKernel:
    """The process' own, not loaded."""
    unloaded = CompiledKernel()
    monkeypatch.setattr(raycast, "RAYCAST_KERNEL", unloaded)
    monkeypatch.setattr(raycast, "_compile", lambda _: raycast.nearest_obstacle)
    monkeypatch.setitem(sys.modules, "numba", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "numba.extending", SimpleNamespace())
    monkeypatch.delenv(VARIABLE, raising=False)
    return unloaded


@pytest.mark.parametrize(
    ("word", "robots", "loads"),
    [
        (None, CROWD - 1, False),
        (None, CROWD, True),
        ("crowd", CROWD, True),
        ("always", 1, True),
        ("never", 10**6, False),
    ],
)
def test_kernel_is_loaded_for_many_robots_or_on_request(
    fresh: CompiledKernel, monkeypatch: pytest.MonkeyPatch, word: str | None, robots: int, loads: bool
) -> None:
    if word is not None:
        monkeypatch.setenv(VARIABLE, word)
    load_compiled(robots)
    assert fresh.tried == loads
    assert (fresh.run is not None) == loads


def test_invalid_variable_is_refused(fresh: CompiledKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(VariableError, match=r"'yes'.* always, crowd, never"):
        load_compiled(1)
    assert not fresh.tried


def test_missing_numba_is_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sought: list[str] = []
    found = builtins.__import__

    def without(name: str, *rest: object, **more: object) -> object:
        if name.startswith("numba"):
            sought.append(name)
            raise ImportError(name)
        return found(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    kernel = CompiledKernel()
    assert not kernel.load()
    assert not kernel.load()
    assert kernel.run is None
    assert sought == ["numba"]


def test_kernel_compiles_without_writable_cache() -> None:
    caches: list[bool] = []

    def njit(signature: object, cache: bool = False) -> object:
        del signature
        caches.append(cache)
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    numba = SimpleNamespace(
        njit=njit,
        float64=lambda *parts: parts,
        int64=None,
        types=SimpleNamespace(Array=lambda *what, **how: (what, how)),
        extending=SimpleNamespace(register_jitable=lambda function: function),
    )
    assert raycast._compile(numba) is raycast.nearest_obstacle
    assert caches == [True, False]
