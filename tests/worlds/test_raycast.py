"""The ray caster against an exact, slow solver in fractions; closed corners, starts on walls."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import cos, hypot, inf, pi, sin, tau

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from worlds import raycast_arrays
from worlds.geometry import polygon_segments
from worlds.raycast import NO_WALL, ON_LINE_IN, ON_WALL_IN, cast_ray, nearest_wall, ray_to_disc, sort_by_range
from worlds.raycast_arrays import cast_discs, cast_each, cast_rays

Pair = tuple[float, float]
Cast = Callable[[tuple[float, float], tuple[float, float], npt.ArrayLike], tuple[float, int]]
Wall = tuple[float, float, float, float]
Rational = tuple[Fraction, Fraction]

SQUARE = polygon_segments([(0, 0), (10, 0), (10, 10), (0, 10)])
EAST, NORTH, WEST, SOUTH = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)


def meeting_exactly(origin: Rational, direction: Rational, wall: Wall) -> Fraction | None:
    """Return the range to a wall in exact fractions, or None: the oracle of these tests.

    Solve origin + t direction = first + u (second - first) by Cramer's rule for the smallest t >= 0 with 0 <= u <= 1.
    Nothing in common with the kernel: no sides, no tolerance.
    """
    x, y = Fraction(wall[0]) - origin[0], Fraction(wall[1]) - origin[1]
    ex, ey = Fraction(wall[2]) - Fraction(wall[0]), Fraction(wall[3]) - Fraction(wall[1])
    dx, dy = direction
    determinant = dx * ey - dy * ex
    if determinant:
        t, u = (x * ey - y * ex) / determinant, (x * dy - y * dx) / determinant
        return t if t >= 0 and 0 <= u <= 1 else None
    # Parallel: the wall is met only if it lies on the line of the ray, at its nearer end.
    if x * dy != y * dx:
        return None
    ends = sorted(((x * dx + y * dy), ((x + ex) * dx + (y + ey) * dy)))
    return max(ends[0], Fraction(0)) if ends[1] >= 0 else None


def alone(origin: Pair, direction: Pair, walls: npt.ArrayLike) -> tuple[float, int]:
    """Cast one ray alone."""
    ranges, rows = cast_rays(origin, direction, walls)
    assert ranges.shape == rows.shape == ()
    return float(ranges), int(rows)


def among(origin: Pair, direction: Pair, walls: npt.ArrayLike) -> tuple[float, int]:
    """Cast one ray in an array with another of the opposite direction."""
    ranges, rows = cast_rays(origin, [direction, (-direction[0], -direction[1])], walls)
    assert ranges.shape == rows.shape == (2,)
    return float(ranges[0]), int(rows[0])


both_kernels = pytest.mark.parametrize("cast", [alone, among])


# Whole numbers and directions of Pythagorean triangles: every side and every range is a fraction with a small
# denominator. So every number that is not exactly zero is far beyond the tolerances, and the kernel must agree in
# every case.

whole = st.integers(-6, 6)
walls_on_grid = st.lists(st.tuples(whole, whole, whole, whole), min_size=1, max_size=6)
triangles = st.sampled_from([(1, 0, 1), (3, 4, 5), (4, 3, 5), (5, 12, 13), (12, 5, 13), (8, 15, 17)])
signs = st.sampled_from([(1, 1), (1, -1), (-1, 1), (-1, -1)])


@both_kernels
@given(st.tuples(whole, whole), triangles, signs, st.booleans(), walls_on_grid)
@example((0, 0), (1, 0, 1), (1, 1), False, [(3, 0, 5, 0)])  # end-on, ahead
@example((4, 0), (1, 0, 1), (1, 1), False, [(3, 0, 5, 0)])  # within the wall, along it
@example((6, 0), (1, 0, 1), (1, 1), False, [(3, 0, 5, 0)])  # end-on, behind
@example((0, 0), (3, 4, 5), (1, 1), False, [(3, 4, 6, 4)])  # grazes an end
@example((0, 0), (3, 4, 5), (1, 1), False, [(3, 4, 6, 4), (3, 4, 6, 3)])  # a corner pointing at the ray's side
@example((3, 4), (3, 4, 5), (1, 1), False, [(3, 4, 6, 4)])  # starts on the end of a wall
@example((0, 0), (1, 0, 1), (1, 1), False, [(2, 0, 2, 0)])  # a wall that is a point
def test_degenerate_cases_agree_with_the_exact_solver(
    cast: Cast,
    origin: tuple[int, int],
    triangle: tuple[int, int, int],
    sign: tuple[int, int],
    swap: bool,
    walls: list[tuple[int, int, int, int]],
) -> None:
    a, b, c = triangle
    exact = (Fraction(sign[0] * a, c), Fraction(sign[1] * b, c))
    exact = exact[::-1] if swap else exact
    met = [meeting_exactly((Fraction(origin[0]), Fraction(origin[1])), exact, wall) for wall in walls]
    ranges = [inf if t is None else float(t) for t in met]

    found, row = cast(origin, (float(exact[0]), float(exact[1])), walls)

    assert found == pytest.approx(min(ranges), abs=1e-12)
    assert row == NO_WALL if found == inf else ranges[row] == pytest.approx(found, abs=1e-12)


# Any numbers at all: the answer must be right for walls moved by a few ON_LINE_IN.

inches = st.floats(-100.0, 100.0)
anywhere = st.tuples(inches, inches)
angles = st.floats(0.0, 2.0 * pi)
SLACK_IN = 4 * ON_LINE_IN


def apart(point: Rational, wall: Wall) -> float:
    """Distance of a point to a wall, the foot of the perpendicular found in fractions."""
    ax, ay, bx, by = (Fraction(number) for number in wall)
    ex, ey, squared = bx - ax, by - ay, (bx - ax) ** 2 + (by - ay) ** 2
    share = ((point[0] - ax) * ex + (point[1] - ay) * ey) / squared if squared else Fraction(0)
    share = min(max(share, Fraction(0)), Fraction(1))
    return hypot(float(point[0] - ax - share * ex), float(point[1] - ay - share * ey))


def surely_blocks(origin: Rational, direction: Rational, wall: Wall, reach: float) -> bool:
    """Return True if the wall stands across the ray before `reach` even if it moves a little."""
    t = meeting_exactly(origin, direction, wall)
    if t is None:
        return False
    # Distances of the wall's ends from the line of the ray: a small one means that the ray grazes an end.
    sides = [
        float(direction[0] * (Fraction(y) - origin[1]) - direction[1] * (Fraction(x) - origin[0]))
        for x, y in (wall[:2], wall[2:])
    ]
    if min(map(abs, sides)) < SLACK_IN:
        return False
    length = hypot(wall[2] - wall[0], wall[3] - wall[1])
    return SLACK_IN < float(t) < reach - SLACK_IN * (1.0 + length / abs(sides[1] - sides[0]))


@both_kernels
@given(anywhere, angles, st.lists(st.tuples(inches, inches, inches, inches), min_size=1, max_size=8))
def test_result_is_right_for_walls_moved_by_tolerances(
    cast: Cast, origin: Pair, angle: float, walls: list[Wall]
) -> None:
    direction = (cos(angle), sin(angle))
    start = (Fraction(origin[0]), Fraction(origin[1]))
    exact = (Fraction(direction[0]), Fraction(direction[1]))

    found, row = cast(origin, direction, walls)

    assert not [wall for wall in walls if surely_blocks(start, exact, wall, found)]
    if found < inf:
        reached = (start[0] + Fraction(found) * exact[0], start[1] + Fraction(found) * exact[1])
        assert apart(reached, walls[row]) < SLACK_IN


@given(st.lists(st.floats(1.0, 100.0), min_size=3, max_size=12), anywhere, angles)
def test_no_ray_leaves_a_closed_outline(radii: list[float], centre: Pair, angle: float) -> None:
    bearings = np.arange(len(radii)) * 2.0 * pi / len(radii)
    corners = np.array(centre) + np.array(radii)[:, np.newaxis] * np.stack(
        (np.cos(bearings), np.sin(bearings)), axis=-1
    )
    outline = polygon_segments(corners)
    # Rays at each corner, and at the next numbers on both sides of that direction: none may slip between two walls.
    aimed = np.arctan2(corners[:, 1] - centre[1], corners[:, 0] - centre[0])
    every = np.concatenate((aimed, np.nextafter(aimed, 9.0), np.nextafter(aimed, -9.0), [angle]))

    ranges, rows = cast_rays(centre, np.stack((np.cos(every), np.sin(every)), axis=-1), outline)

    assert np.isfinite(ranges).all()
    assert (rows != NO_WALL).all()
    np.testing.assert_allclose(ranges[: len(radii)], radii, atol=1e-6)
    for bearing in every:
        assert np.isfinite(cast_rays(centre, (cos(bearing), sin(bearing)), outline)[0])


@pytest.mark.parametrize("far", [0.0, 9.9e4])
def test_a_shared_corner_far_from_the_origin_does_not_leak(far: float) -> None:
    # Walls end to end, and rays at the points that two of them share; far from the origin rounding is larger.
    fan = [(far + 100.0, far + y, far + 100.0, far + y + 0.1) for y in np.arange(-50, 50) / 10.0]
    rng = np.random.default_rng(1)
    origins = far + np.stack((rng.uniform(0.0, 50.0, 500), rng.uniform(-4.0, 4.0, 500)), axis=-1)
    corners = np.array(fan)[rng.integers(1, 100, 500), :2]
    # Unit vectors to the corners.
    directions = (corners - origins) / np.hypot(*(corners - origins).T)[:, np.newaxis]

    ranges, _ = cast_rays(origins, directions, fan)

    np.testing.assert_allclose(ranges, np.hypot(*(corners - origins).T), atol=1e-8)


@both_kernels
@pytest.mark.parametrize("direction", [EAST, NORTH, WEST, SOUTH, (0.6, 0.8), (-0.8, 0.6)])
@pytest.mark.parametrize("origin", [(10.0, 5.0), (5.0, 0.0), (0.0, 0.0), (10.0, 10.0)])
def test_a_ray_that_starts_on_a_wall_meets_it_at_0(
    cast: Cast, origin: Pair, direction: Pair
) -> None:
    assert cast(origin, direction, SQUARE)[0] == 0.0


@both_kernels
@given(anywhere, anywhere, st.floats(0.0, 1.0), st.floats(0.001, pi - 0.001), st.booleans())
def test_a_start_on_a_slanted_wall_survives_rounding(
    cast: Cast, first: Pair, second: Pair, share: float, angle: float, behind: bool
) -> None:
    assume(hypot(second[0] - first[0], second[1] - first[1]) > 0.1)
    origin = (first[0] + share * (second[0] - first[0]), first[1] + share * (second[1] - first[1]))
    direction = np.arctan2(second[1] - first[1], second[0] - first[0]) + (angle if behind else -angle)

    found, row = cast(origin, (cos(direction), sin(direction)), [(*first, *second)])

    assert found == pytest.approx(0.0, abs=1e-9)
    assert row == 0


@both_kernels
def test_a_start_within_tolerance_behind_a_wall_is_on_it(cast: Cast) -> None:
    wall = [(10.0, 0.0, 10.0, 10.0)]
    assert cast((10.0 + 0.5 * ON_WALL_IN, 5.0), EAST, wall) == (0.0, 0)
    assert cast((10.0 + 2.0 * ON_WALL_IN, 5.0), EAST, wall) == (inf, NO_WALL)


@both_kernels
def test_an_end_within_tolerance_of_the_ray_is_met(cast: Cast) -> None:
    assert cast((0.0, 0.0), EAST, [(5.0, 0.5 * ON_LINE_IN, 5.0, 9.0)]) == (5.0, 0)
    assert cast((0.0, 0.0), EAST, [(5.0, 2.0 * ON_LINE_IN, 5.0, 9.0)]) == (inf, NO_WALL)


@both_kernels
@pytest.mark.parametrize(("grazed", "other"), [(5.0, 9.0), (9.0, 5.0)])
def test_a_nearly_parallel_wall_is_met_within_its_ends(cast: Cast, grazed: float, other: float) -> None:
    # Its line meets the ray 18 in beyond the grazed end.
    wall = [(grazed, 0.9 * ON_LINE_IN, other, 1.1 * ON_LINE_IN)]
    assert cast((0.0, 0.0), EAST, wall) == (grazed, 0)


def test_tolerances_lie_between_rounding_and_robot_units() -> None:
    # 1e5 in is the size of the largest world: its rounding must be below the tolerances.
    assert 1e5 * np.finfo(float).eps * 10 < min(ON_LINE_IN, ON_WALL_IN)
    # They must be below 1e-8 in, far below the 1/10 inch of the robots.
    assert max(ON_LINE_IN, ON_WALL_IN) < 1e-6 * 1e-2


@both_kernels
def test_a_parallel_wall_is_not_met(cast: Cast) -> None:
    assert cast((0.0, 0.0), EAST, [(1.0, 3.0, 9.0, 3.0), (1.0, -3.0, 9.0, -3.0)]) == (inf, NO_WALL)


@both_kernels
def test_a_wall_seen_end_on_is_met_at_its_nearer_end(cast: Cast) -> None:
    wall = [(3.0, 0.0, 7.0, 0.0)]
    assert cast((0.0, 0.0), EAST, wall) == (3.0, 0)
    assert cast((9.0, 0.0), WEST, wall) == (2.0, 0)
    assert cast((9.0, 0.0), EAST, wall) == (inf, NO_WALL)


@both_kernels
def test_nearest_of_several_walls_is_returned(cast: Cast) -> None:
    walls = [(9.0, -1.0, 9.0, 1.0), (4.0, -1.0, 4.0, 1.0), (-2.0, -1.0, -2.0, 1.0)]
    assert cast((0.0, 0.0), EAST, walls) == (4.0, 1)
    assert cast((0.0, 0.0), WEST, walls) == (2.0, 2)


@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 3), (0,)])
def test_without_walls_nothing_is_met_in_any_shape(shape: tuple[int, ...]) -> None:
    ranges, rows = cast_rays(np.zeros((*shape, 2)), np.broadcast_to(EAST, (*shape, 2)), np.empty((0, 4)))
    assert ranges.shape == rows.shape == shape
    assert np.isinf(ranges).all()
    assert (rows == NO_WALL).all()
    assert (ranges.dtype, rows.dtype) == (np.dtype(np.float64), np.dtype(np.intp))


@pytest.mark.parametrize(
    ("origin_shape", "direction_shape", "shape"),
    [
        ((2,), (2,), ()),
        ((2,), (16, 2), (16,)),
        ((5, 2), (2,), (5,)),
        ((4, 3, 1, 2), (16, 2), (4, 3, 16)),
        ((0, 2), (2,), (0,)),
    ],
)
def test_leading_dimensions_broadcast(
    origin_shape: tuple[int, ...], direction_shape: tuple[int, ...], shape: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(2)
    starts = rng.uniform(1.0, 9.0, origin_shape)
    directions = rng.normal(size=direction_shape)
    directions /= np.hypot(directions[..., 0], directions[..., 1])[..., np.newaxis]

    ranges, rows = cast_rays(starts, directions, SQUARE)

    assert ranges.shape == rows.shape == shape
    assert (ranges.dtype, rows.dtype) == (np.dtype(np.float64), np.dtype(np.intp))
    starts, directions = np.broadcast_to(starts, (*shape, 2)), np.broadcast_to(directions, (*shape, 2))
    for place in np.ndindex(shape):
        distance, row = cast_rays(starts[place], directions[place], SQUARE)
        assert ranges[place] == pytest.approx(float(distance), abs=1e-12)
        assert rows[place] == row


@pytest.mark.parametrize("walls", [0, 1, 9, 60])
def test_selected_walls_give_the_same_bits_as_all(walls: int) -> None:
    rng = np.random.default_rng(14)
    corners = np.vstack((SQUARE, rng.uniform(0.0, 10.0, (60, 4))))[:walls]
    places = rng.uniform(0.0, 10.0, (40, 2)).tolist()
    # Corners and a point on a wall among the origins.
    places[::8] = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (5.0, 0.0)]
    angles = rng.uniform(0.0, tau, 40).tolist()
    angles[::4] = [0.0, pi / 2, pi, 1.5 * pi, 0.0] * 2
    rays = [(x, y, cos(angle), sin(angle)) for (x, y), angle in zip(places, angles, strict=True)]
    found = [cast_ray(*ray, corners) for ray in rays]
    assert found == [nearest_wall(*ray, corners) for ray in rays]
    ranges = [distance for distance, _ in found]
    for count in (1, 2, 3, 16, 40):
        assert ranges == [each for at in range(0, 40, count) for each in cast_each(rays[at : at + count], corners)]
    # Starts on a wall read 0 as soon as there is a wall; fewer than four walls of the square leave gaps.
    assert (0.0 in ranges) == (walls > 0)
    assert (inf in ranges) == (walls < 4)


def test_block_size_does_not_change_result(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    origins, turns = rng.uniform(0.0, 10.0, (101, 2)), rng.uniform(0.0, 2.0 * pi, 101)
    directions = np.stack((np.cos(turns), np.sin(turns)), axis=-1)
    walls = rng.uniform(0.0, 10.0, (7, 4))
    whole_ranges, whole_rows = cast_rays(origins, directions, walls)

    # Smaller blocks than the 707 pairs of 101 rays and 7 walls.
    monkeypatch.setattr(raycast_arrays, "_BLOCK", 70)
    ranges, rows = cast_rays(origins, directions, walls)

    np.testing.assert_allclose(ranges, whole_ranges, atol=1e-12)
    np.testing.assert_array_equal(rows, whole_rows)


@both_kernels
def test_walls_may_be_any_view_and_are_not_written(cast: Cast) -> None:
    columns = np.asfortranarray(SQUARE)
    columns.setflags(write=False)
    assert cast((2.0, 5.0), EAST, columns) == (8.0, 1)
    assert cast((2.0, 5.0), EAST, SQUARE[1::2]) == (8.0, 0)
    assert cast((2.0, 5.0), EAST, SQUARE.astype(np.int64)) == (8.0, 1)


def many_cornered(disc: tuple[float, float, float], corners: int = 2000) -> list[tuple[float, float]]:
    """Return the oracle of a disc: a polygon whose corners lie on its rim, nowhere more than 2e-5 in inside it."""
    x, y, radius = disc
    return [(x + radius * cos(2 * pi * k / corners), y + radius * sin(2 * pi * k / corners)) for k in range(corners)]


@given(st.lists(st.tuples(*[st.floats(-80, 80)] * 2, st.floats(1, 15)), min_size=1, max_size=3), st.floats(-4, 4))
def test_disc_range_agrees_with_polygon_of_many_corners(discs: list[tuple[float, float, float]], angle: float) -> None:
    direction = cos(angle), sin(angle)
    for x, y, radius in discs:
        assume(hypot(x, y) > radius + 0.1)
        # A ray that grazes a disc may pass between two corners of the polygon.
        assume(abs(abs(direction[0] * y - direction[1] * x) - radius) > 0.1)
    rims = np.concatenate([polygon_segments(many_cornered(disc)) for disc in discs])
    expected, _ = cast_rays((0.0, 0.0), direction, rims)
    assert float(cast_discs((0.0, 0.0), direction, discs)) == pytest.approx(float(expected), abs=1e-3)


def test_disc_behind_or_around_the_origin_and_no_disc() -> None:
    assert float(cast_discs((0, 0), EAST, [(-20, 0, 5)])) == inf
    assert float(cast_discs((0, 0), EAST, [(3, 0, 5)])) == 0.0
    assert float(cast_discs((0, 0), EAST, [(20, 5, 5)])) == 20.0
    assert float(cast_discs((0, 0), EAST, [])) == inf
    many = cast_discs([(0, 0), (0, 10)], [EAST, NORTH], [(20, 0, 5), (0, 40, 10)])
    assert many.tolist() == [15.0, 20.0]


@pytest.mark.long
def test_scalar_disc_range_equals_array_exactly() -> None:
    rng = np.random.default_rng(12)
    discs = np.column_stack((rng.uniform(-50.0, 50.0, (200, 2)), rng.uniform(1.0, 20.0, 200)))
    for angle in rng.uniform(0.0, tau, 20).tolist():
        direction = cos(angle), sin(angle)
        met = [ray_to_disc(3.0, -2.0, *direction, disc) for disc in discs.tolist()]
        assert met == [float(cast_discs((3.0, -2.0), direction, disc)) for disc in discs]
        assert inf in met
        assert 0.0 in met


@given(st.lists(st.tuples(st.sampled_from([-1.0, 0.0, 0.5, 2.0, inf]), st.integers())))
def test_rows_are_sorted_by_range_and_equal_ones_stay(rows: list[tuple[float, int]]) -> None:
    expected = sorted(rows, key=lambda row: row[0])
    sort_by_range(rows)
    assert rows == expected
