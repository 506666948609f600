"""Lines and arcs against walls: an exact slow computation is the judge, fractions for lines, fifty digits for arcs."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nserver_emu.server.handlers.world import Arc, Hit, arc_hit, line_hit

pytestmark = pytest.mark.long

GRID = st.integers(-40, 40)
WALL = st.tuples(GRID, GRID, GRID, GRID).filter(lambda w: w[:2] != w[2:])
WALLS = st.lists(WALL, min_size=1, max_size=6)
FACING_WEST, FACING_UP = math.pi, math.pi / 2


def exact_line_share(start: tuple[int, int], end: tuple[int, int], wall: tuple[int, ...]) -> list[Fraction]:
    """Return the smallest fraction 0..1 of the path at which it meets the wall; empty if it does not."""
    (x, y), (dx, dy) = start, (end[0] - start[0], end[1] - start[1])
    px, py, qx, qy = wall[0] - x, wall[1] - y, wall[2] - wall[0], wall[3] - wall[1]
    # Cramer's rule: fraction along the path, and along the wall.
    cross = dx * qy - dy * qx
    if cross:
        share, along = Fraction(px * qy - py * qx, cross), Fraction(px * dy - py * dx, cross)
        return [share] if 0 <= share <= 1 and 0 <= along <= 1 else []
    # Parallel: no hit unless both are on one line; then the first common point.
    if dx * py - dy * px:
        return []
    square = dx * dx + dy * dy
    ends = sorted(Fraction(a * dx + b * dy, square) for a, b in ((px, py), (px + qx, py + qy)))
    first = max(ends[0], Fraction(0))
    return [first] if first <= min(ends[1], Fraction(1)) else []


@given(st.tuples(GRID, GRID), st.tuples(GRID, GRID), WALLS)
@settings(max_examples=300)
def test_line_hits_agree_with_exact_fractions(
    start: tuple[int, int], end: tuple[int, int], walls: list[tuple[int, ...]]
) -> None:
    if start == end:
        return
    shares = [share for wall in walls for share in exact_line_share(start, end, wall)]
    hit = line_hit(start, end, np.array(walls, dtype=float))
    assert (hit is None) == (not shares)
    if hit is not None:
        nearest = float(min(shares))
        assert hit.x_in == pytest.approx(start[0] + nearest * (end[0] - start[0]), abs=1e-8)
        assert hit.y_in == pytest.approx(start[1] + nearest * (end[1] - start[1]), abs=1e-8)
        # The normal faces the path: its component along the path is not positive.
        assert math.cos(hit.normal_rad - math.atan2(end[1] - start[1], end[0] - start[0])) <= 1e-9


def exact_sweeps(centre: tuple[int, int], radius: int, wall: tuple[int, ...]) -> list[float]:
    """Polar angles at which the circle meets the wall, by the quadratic in fifty digits."""
    with localcontext() as digits:
        digits.prec = 50
        px, py = Decimal(wall[0] - centre[0]), Decimal(wall[1] - centre[1])
        dx, dy = Decimal(wall[2] - wall[0]), Decimal(wall[3] - wall[1])
        # The circle |p + t d| = r around the centre: a t^2 + 2 b t + c = 0.
        a, b, c = dx * dx + dy * dy, px * dx + py * dy, px * px + py * py - radius * radius
        discriminant = b * b - a * c
        if discriminant < 0:
            return []
        shares = {(-b + sign * discriminant.sqrt()) / a for sign in (-1, 1)}
        return [math.atan2(py + t * dy, px + t * dx) for t in shares if 0 <= t <= 1]


@given(
    st.tuples(GRID, GRID), st.integers(1, 40), st.integers(-60, 60), st.integers(-60, 60), WALLS
)
@settings(max_examples=300)
def test_arc_hits_agree_with_fifty_digit_arithmetic(
    centre: tuple[int, int], radius: int, begin: int, end: int, walls: list[tuple[int, ...]]
) -> None:
    # Offsets that no corner of the grid has, so that arcs do not begin exactly at walls.
    first, last = begin / 10 + 0.0123, end / 10 + 0.0456
    turn, sweep = math.copysign(1.0, last - first), abs(last - first)
    angles = [angle for wall in walls for angle in exact_sweeps(centre, radius, wall)]
    swept = sorted(turn * (angle - first) % math.tau for angle in angles)
    # A hit within rounding of an end of the arc may or may not count: such examples are left out.
    near_an_end = [s for s in swept if min(abs(s - sweep), s, math.tau - s) < 1e-7]
    if near_an_end:
        return
    expected = [s for s in swept if s <= sweep]
    hit = arc_hit(Arc(*centre, radius, first, last), np.array(walls, dtype=float))
    assert (hit is None) == (not expected)
    if hit is not None:
        angle = first + turn * expected[0]
        assert (hit.x_in, hit.y_in) == pytest.approx(
            (centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle)), abs=1e-6
        )
        # The path runs along the tangent, at right angles to the radius.
        assert math.cos(hit.normal_rad - (angle + turn * math.pi / 2)) <= 1e-7


WALL_AHEAD = np.array([[10.0, -5.0, 10.0, 5.0]])


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    # From both sides; begin on the wall, end on it, just before it, at its end; a path of length 0 on it and beside
    # it.
    [
        ((0, 0), (20, 0), Hit(10, 0, FACING_WEST)),
        ((20, 0), (0, 0), Hit(10, 0, 0.0)),
        ((10, 0), (20, 0), Hit(10, 0, FACING_WEST)),
        ((0, 0), (10, 0), Hit(10, 0, FACING_WEST)),
        ((0, 0), (9.99, 0), None),
        ((0, 0), (10, 5), Hit(10, 5, FACING_WEST)),
        ((10, 2), (10, 2), Hit(10, 2, FACING_WEST)),
        ((3, 3), (3, 3), None),
    ],
)
def test_a_line_at_the_edge(start: tuple[float, float], end: tuple[float, float], expected: Hit | None) -> None:
    hit = line_hit(start, end, WALL_AHEAD)
    assert hit == (None if expected is None else pytest.approx(expected, abs=1e-9))


@pytest.mark.parametrize(
    ("arc", "expected"),
    [
        (Arc(0, 0, 10, -1.0, 1.0), Hit(10, 0, FACING_WEST)),
        (Arc(0, 0, 10, 0.0, 1.0), Hit(10, 0, FACING_WEST)),
        (Arc(0, 0, 10, -1.0, 0.0), Hit(10, 0, FACING_WEST)),
        (Arc(0, 0, 9.9, -1.0, 1.0), None),
        (Arc(10, 10, 10, -1.5, -math.pi / 2), Hit(10, 0, 0.0)),
        (Arc(10, 10, 10, -1.6, -math.pi / 2), Hit(10, 0, FACING_WEST)),
        (Arc(10, 2, 0.0, 0.0, 1.0), Hit(10, 2, 0.0)),
    ],
    ids=["touches", "starts there", "ends there", "too small", "clockwise", "counter-clockwise", "a point"],
)
def test_an_arc_at_the_edge(arc: Arc, expected: Hit | None) -> None:
    hit = arc_hit(arc, WALL_AHEAD)
    if expected is None:
        assert hit is None
    else:
        assert hit is not None
        assert hit[:2] == pytest.approx(expected[:2], abs=1e-9)
        assert math.cos(hit.normal_rad - expected.normal_rad) == pytest.approx(1.0) or arc.radius_in == 0.0


def test_where_nothing_stands_nothing_is_met() -> None:
    nothing = np.empty((0, 4))
    assert line_hit((0, 0), (5, 5), nothing) is None
    assert arc_hit(Arc(0, 0, 5, 0, 7), nothing) is None
