"""A fan of rays among many walls equals the same rays cast one by one."""

from __future__ import annotations

from math import cos, hypot, inf, radians, sin

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from worlds import raycast_arrays
from worlds.geometry import FloatArray, near_walls
from worlds.raycast_arrays import cast_fan, cast_rays

ANGLES = np.linspace(-radians(30.0), radians(30.0), 61)
REACH_IN = 180.0
NUMBERS = st.integers(-200, 200).map(float)
WALLS = st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), max_size=60)


# The oracle: each ray against each wall, and what is beyond the reach counts as nothing.
def cast_singly(x: float, y: float, angles: FloatArray, walls: FloatArray) -> FloatArray:
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    ranges = cast_rays((x, y), directions, walls)[0]
    return np.where(ranges <= REACH_IN, ranges, inf)


@given(WALLS, NUMBERS, NUMBERS, st.floats(-4.0, 4.0))
# A wall that lies in the ray's direction, a wall through the origin, walls on both sides of the direction pi, and a
# wall without a length.
@example([(10.0, 0.0, 20.0, 0.0)], 0.0, 0.0, 0.0)
@example([(-10.0, 5.0, 10.0, -5.0)], 0.0, 0.0, 0.0)
@example([(-150.0, 1.0, 150.0, 1.0), (-150.0, -1.0, 150.0, -1.0)], 0.0, 0.0, 3.1)
@example([(0.0, 0.0, 0.0, 0.0)], 0.0, 0.0, 0.0)
def test_a_fan_equals_single_rays(
    rows: list[tuple[float, float, float, float]], x: float, y: float, turned: float
) -> None:
    walls = np.array(rows).reshape(-1, 4)
    found = cast_fan(x, y, turned + ANGLES, walls, REACH_IN)
    np.testing.assert_allclose(found, cast_singly(x, y, turned + ANGLES, walls), rtol=1e-9, atol=1e-6)


def crowd(count: int) -> FloatArray:
    """Return the walls of squares on rings around (0, 0)."""
    rng = np.random.default_rng(1)
    corners = []
    for x, y in rng.uniform(-170.0, 170.0, (count, 2)).tolist():
        if hypot(x, y) > 20.0:
            corners += [(x, y, x + 3, y), (x + 3, y, x + 3, y + 3), (x + 3, y + 3, x, y + 3), (x, y + 3, x, y)]
    return np.array(corners)


@pytest.mark.parametrize("walls", [
    # Small walls in all directions, and a thousand walls of which each hides the next one.
    crowd(1000),
    np.array([(30.0 + 0.1 * row, -150.0, 30.0 + 0.1 * row, 150.0) for row in range(1000)]),
], ids=["crowd", "one behind another"])  # fmt: skip
def test_pairs_of_a_fan_are_few(walls: FloatArray, monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = 0
    meet = raycast_arrays._meet

    def counted(sides: FloatArray, aheads: FloatArray) -> FloatArray:
        nonlocal pairs
        pairs += sides.size // 2
        return meet(sides, aheads)

    angles = np.linspace(-radians(30.0), radians(30.0), 482)
    expected = cast_singly(0.0, 0.0, angles, walls)
    monkeypatch.setattr(raycast_arrays, "_meet", counted)
    np.testing.assert_allclose(cast_fan(0.0, 0.0, angles, walls, REACH_IN), expected, atol=1e-6)
    # Fewer than a tenth of all pairs of a wall and a ray are computed.
    assert pairs < 0.1 * len(walls) * len(angles)


def test_walls_near_a_point_include_all_in_reach() -> None:
    walls = crowd(300)
    near = near_walls(50.0, 20.0, 40.0, walls)
    assert len(near) < len(walls)
    # A ray that reaches nothing within 40 in may differ: only walls within that distance were selected.
    for angle in np.linspace(0.0, 6.28, 100):
        ray = (50.0, 20.0), (cos(angle), sin(angle))
        everywhere, selected = cast_rays(*ray, walls)[0], cast_rays(*ray, near)[0]
        assert selected == everywhere or (everywhere > 40.0 and selected > 40.0)
