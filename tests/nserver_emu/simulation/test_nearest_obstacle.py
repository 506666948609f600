"""The compiled kernel against arrays, bit for bit, and the conditions for loading it."""

from __future__ import annotations

from math import cos, inf, sin

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nclient.errors import VariableError
from nserver_emu.simulation import visibility
from nserver_emu.simulation.visibility import (
    MAX_ROBOT_RANGE_IN,
    NEAREST_OBSTACLE,
    load_compiled,
    nearest_disc,
    nearest_obstacle,
)
from worlds.compiled import CROWD, VARIABLE, CompiledFunction
from worlds.geometry import FloatArray, polygon_segments
from worlds.raycast import cast_ray
from worlds.raycast_arrays import cast_discs

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
def kernel() -> CompiledFunction:
    """Machine code, of this module alone."""
    pytest.importorskip("numba")
    loaded = unloaded()
    assert loaded.load()
    return loaded


def unloaded() -> CompiledFunction:
    """Return another `NEAREST_OBSTACLE`, not compiled."""
    return CompiledFunction(nearest_obstacle, NEAREST_OBSTACLE._sources, NEAREST_OBSTACLE._example)


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
    kernel: CompiledFunction,
    place: tuple[float, float],
    direction: tuple[float, float],
    walls: FloatArray,
    discs: list[tuple[float, float, float]],
    own: int,
) -> None:
    robots = by_x(discs)
    walls.setflags(write=False)
    handed = *place, *direction, walls, robots, own, 20.0
    found, in_numbers = kernel.run(*handed), float(nearest_obstacle(*handed))
    in_reach = np.abs(robots[:, 0] - place[0]) <= MAX_ROBOT_RANGE_IN
    to_disc = float(cast_discs(place, direction, robots[(robots[:, 3] != own) & in_reach, :3]))
    to_wall = cast_ray(*place, *direction, walls)[0] if len(walls) else inf
    in_lists = nearest_disc(*place, *direction, to_wall, robots.tolist(), own, 20.0)
    assert found.hex() == in_numbers.hex() == in_lists.hex() == min(to_wall, to_disc).hex()


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the sizes of groups at which code was compiled: empty."""
    compiled: list[int] = []
    own = unloaded()
    monkeypatch.setattr(visibility, "NEAREST_OBSTACLE", own)
    monkeypatch.setattr(own, "load", lambda: compiled.append(1))
    monkeypatch.delenv(VARIABLE, raising=False)
    return compiled


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
    fresh: list[int], monkeypatch: pytest.MonkeyPatch, word: str | None, robots: int, loads: bool
) -> None:
    if word is not None:
        monkeypatch.setenv(VARIABLE, word)
    load_compiled(robots)
    assert bool(fresh) == loads


def test_invalid_variable_is_refused(fresh: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(VariableError, match=r"'yes'.* always, crowd, never"):
        load_compiled(1)
    assert not fresh


def test_compiled_code_is_loaded_once(fresh: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visibility.NEAREST_OBSTACLE, "is_compiled", True)
    load_compiled(CROWD)
    assert not fresh
