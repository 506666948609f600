"""The kernels of plane geometry against slower methods: sampling, fractions, sums of angles."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
from math import atan2, hypot, pi, sin, tau

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from worlds.geometry import (
    area,
    crossing,
    inside,
    lengths,
    nearest_points,
    normals,
    polygon_segments,
    polyline_segments,
)

Pair = tuple[float, float]

inches = st.floats(-100.0, 100.0)
points = st.tuples(inches, inches)
whole = st.integers(-8, 8)
grid = st.tuples(whole, whole)
SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]


def test_segment_counts_of_polyline_and_polygon() -> None:
    assert polyline_segments([(0, 0), (1, 0), (1, 2)]).tolist() == [[0, 0, 1, 0], [1, 0, 1, 2]]
    assert polyline_segments([(5, 6)]).shape == (0, 4)
    assert polygon_segments([(0, 0), (1, 0), (1, 2)]).tolist() == [[0, 0, 1, 0], [1, 0, 1, 2], [1, 2, 0, 0]]


@given(points, points)
def test_lengths_and_normals(first: Pair, second: Pair) -> None:
    along = np.array(second) - np.array(first)
    assume(np.abs(along).max() > 1e-3)
    segment = np.array([[*first, *second]])

    assert lengths(segment)[0] == pytest.approx(hypot(*along))
    normal = normals(segment)[0]
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert normal @ along == pytest.approx(0.0, abs=1e-9)
    # To the left.
    # The cross product of direction and normal is positive.
    assert along[0] * normal[1] - along[1] * normal[0] > 0.0


@given(points, points, points)
def test_the_nearest_point_is_as_near_as_a_search_finds(here: Pair, first: Pair, second: Pair) -> None:
    near, distances = nearest_points(here, np.array([[*first, *second]]))

    low, high = 0.0, 1.0
    for _ in range(200):  # the distance is convex along the segment: cut off the worse third
        left, right = low + (high - low) / 3, high - (high - low) / 3
        if _apart(here, first, second, left) < _apart(here, first, second, right):
            high = right
        else:
            low = left
    assert distances[0] == pytest.approx(_apart(here, first, second, low), abs=1e-6)
    assert hypot(near[0, 0] - here[0], near[0, 1] - here[1]) == pytest.approx(distances[0])


def _apart(here: Pair, first: Pair, second: Pair, share: float) -> float:
    x, y = first[0] + share * (second[0] - first[0]), first[1] + share * (second[1] - first[1])
    return hypot(x - here[0], y - here[1])


def test_nearest_points_with_zero_length_segment() -> None:
    segments = np.array([[0.0, 0.0, 10.0, 0.0], [3.0, 4.0, 3.0, 4.0]])
    near, distances = nearest_points([[[5.0, 2.0], [-3.0, -4.0]]], segments)
    assert near.tolist() == [[[[5.0, 0.0], [3.0, 4.0]], [[0.0, 0.0], [3.0, 4.0]]]]
    np.testing.assert_allclose(distances, [[[2.0, hypot(2.0, 2.0)], [5.0, 10.0]]])


def _winding(here: Pair, corners: list[tuple[int, int]]) -> int:
    """Return how often the outline turns around a point: the sum of the angles under which its edges are seen."""
    total = 0.0
    for (x1, y1), (x2, y2) in zip(corners, corners[1:] + corners[:1], strict=True):
        turn = atan2(y2 - here[1], x2 - here[0]) - atan2(y1 - here[1], x1 - here[0])
        # Each angle between -180 and 180 degrees: the direction in which the edge is seen to turn.
        total += (turn + pi) % tau - pi
    return round(total / tau)


@given(grid, st.lists(grid, min_size=3, max_size=8))
def test_inside_is_an_odd_number_of_turns_of_the_outline(here: tuple[int, int], corners: list[tuple[int, int]]) -> None:
    # Off the grid, so never on an edge of such small numbers.
    point = (here[0] + 0.137, here[1] + 0.291)
    edges = polygon_segments(corners)
    assume(nearest_points(point, edges)[1].min() > 1e-9)
    assert inside(point, edges).tolist() == [_winding(point, corners) % 2 == 1]


def test_inside_of_several_polygons_for_many_points() -> None:
    shifted = np.array(SQUARE)[::-1] + np.array([3.0, 0.0])
    edges = np.concatenate((polygon_segments(SQUARE), polygon_segments(shifted)))
    within = inside([[(1.0, 1.0), (3.5, 1.0)], [(6.0, 1.0), (9.0, 9.0)]], edges, (0, 4))
    assert within.tolist() == [[[True, False], [True, True]], [[False, True], [False, False]]]


@pytest.mark.parametrize("count", [3, 4, 17])
def test_the_area_of_a_regular_polygon_far_from_the_origin(count: int) -> None:
    turns = np.arange(count) * tau / count
    corners = 5.0 * np.stack((np.cos(turns), np.sin(turns)), axis=-1) + 1e4
    # n triangles with two sides of 5 and the angle 2 pi / n between them; 1e4 is far compared with their size.
    expected = count / 2 * 25.0 * sin(tau / count)
    assert area(corners) == pytest.approx(expected, rel=1e-9)
    assert area(corners[::-1]) == pytest.approx(-expected, rel=1e-9)


def _cross(one: list[int], other: list[int]) -> bool:
    """Return True if two segments cross between their ends: the meeting of their lines, in fractions."""
    ex, ey, fx, fy = one[2] - one[0], one[3] - one[1], other[2] - other[0], other[3] - other[1]
    determinant = ex * fy - ey * fx
    # Parallel segments do not cross between their ends.
    if determinant == 0:
        return False
    x, y = other[0] - one[0], other[1] - one[1]
    shares = Fraction(x * fy - y * fx, determinant), Fraction(x * ey - y * ex, determinant)
    return all(0 < share < 1 for share in shares)


@given(st.lists(grid, min_size=3, max_size=7))
def test_the_first_two_edges_that_cross_are_found(corners: list[tuple[int, int]]) -> None:
    edges = polygon_segments(corners)
    rows = edges.astype(int).tolist()
    # The oracle computes all pairs in fractions, without rounding.
    pairs = [pair for pair in combinations(range(len(rows)), 2) if _cross(rows[pair[0]], rows[pair[1]])]
    assert crossing(edges) == (pairs[0] if pairs else None)


def test_a_square_does_not_cross_itself_and_a_bow_tie_does() -> None:
    assert crossing(polygon_segments(SQUARE)) is None
    assert crossing(polygon_segments([SQUARE[0], SQUARE[1], SQUARE[3], SQUARE[2]])) == (1, 3)
