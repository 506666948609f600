"""The table of expected ranges: its two forms against each other, coarse places and those required later."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters import range_table
from localization.filters.compiled import ConeSonarRow, row_of
from localization.filters.range_table import (
    DIRECTIONS,
    HEADING_STD_RAD,
    MAX_SMALL_PLACES,
    RangeTable,
    build_range_table,
    compiled_echoes,
    connected,
    decoded,
    likeliest_echoes,
)
from localization.filters.sonar_cone import ConeSonar, expected_echoes, reflectors, rows_of
from localization.filters.sonar_ray import RaySonar, wall_map
from worlds.compiled import VARIABLE
from worlds.geometry import polygon_segments
from worlds.io import load_world
from worlds.raycast import cast_ray
from worlds.rings import SonarMount
from worlds.robots import N150

RING_IN = N150.sonar_ring_radius_in
ROOMS = load_world("several_walls").walls
PLACES = np.array([[25.0, 20.0], [30.0, 60.0], [55.0, 40.0]])
LARGE = polygon_segments([(0.0, 0.0), (1400.0, 0.0), (1400.0, 350.0), (0.0, 350.0)])


@pytest.fixture(scope="module")
def large() -> RangeTable:
    return build_range_table(LARGE, N150, RaySonar(), 9.0)


def plain_echoes(directions: int) -> tuple[np.ndarray, np.ndarray]:
    """The function that numba compiles, in plain Python."""
    sonar, segments = ConeSonar(), wall_map(ROOMS).segments
    faces, vertices = rows_of(reflectors(segments), sonar)
    ranges, probabilities = np.zeros((len(PLACES), directions)), np.zeros((len(PLACES), directions))
    likeliest_echoes(
        PLACES, RING_IN, HEADING_STD_RAD, row_of(ConeSonarRow, sonar), segments, faces, vertices, ranges, probabilities
    )
    return ranges, probabilities


def test_echoes_one_by_one_are_those_in_arrays() -> None:
    ranges, probabilities = plain_echoes(24)
    around = reflectors(wall_map(ROOMS).segments)
    for place, row, likeliest in zip(PLACES, ranges, probabilities, strict=True):
        for k in range(24):
            exact = expected_echoes(
                np.array([*place, 2.0 * np.pi * k / 24]), np.array(HEADING_STD_RAD), SonarMount(0.0, RING_IN), around,
                ConeSonar(),
            )  # fmt: skip
            best = int(exact.probability.argmax())
            assert likeliest[k] == pytest.approx(exact.probability[best], abs=1e-9)
            if likeliest[k] > 0.0:
                assert row[k] == pytest.approx(exact.ranges_in[best], abs=1e-9)
    assert (probabilities > 0.9).mean() > 0.3


@pytest.mark.long
def test_compiled_echoes_equal_plain_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    around = reflectors(wall_map(ROOMS).segments)
    assert compiled_echoes(PLACES, 24, around, RING_IN, HEADING_STD_RAD, ConeSonar()) is None, "the tests run plain"
    monkeypatch.setenv(VARIABLE, "always")
    range_table._is_used.cache_clear()
    found = compiled_echoes(PLACES, 24, around, RING_IN, HEADING_STD_RAD, ConeSonar())
    range_table._is_used.cache_clear()
    assert found is not None
    for part, plain in zip(found, plain_echoes(24), strict=True):
        np.testing.assert_allclose(part, plain, rtol=1e-12)


def test_one_place_stands_for_its_neighbours(large: RangeTable) -> None:
    count, cells = len(large.places_in), large.coarse_cells
    assert count > MAX_SMALL_PLACES
    offset = large.places_in - large.places_in[large.representative[:-1]]
    assert (np.abs(offset) <= (cells - 1) * large.cell_in + 1e-9).all()
    assert (large.representative[large.coarse_places] == large.coarse_places).all()
    assert large.is_known[large.coarse_places].all()
    assert not large.is_known[:count].all()


def test_required_places_have_the_ranges_of_the_ray_caster(large: RangeTable) -> None:
    numbers = np.array([5, 1001, 6002])
    numbers = numbers[~large.is_known[numbers]]
    assert len(numbers)
    assert large.require(numbers)
    assert not large.require(numbers)
    for number in numbers.tolist():
        x, y = large.places_in[number].tolist()
        for direction in range(0, DIRECTIONS, 17):
            angle = 2.0 * np.pi * direction / DIRECTIONS
            exact = cast_ray(x, y, np.cos(angle), np.sin(angle), np.asarray(LARGE))[0] - RING_IN
            range_in, probability = (part.item() for part in decoded(np.array(int(large.codes[direction, number]))))
            if exact < 254.5:
                assert range_in == pytest.approx(exact, abs=0.5 + 1e-6)
            assert probability == (exact < 254.5)


def test_places_beside_others_are_those_at_the_displaced_points(large: RangeTable) -> None:
    rng = np.random.default_rng(0)
    places = rng.integers(0, len(large.places_in), 300)
    shift = large.cell_in * rng.integers(-90, 91, (300, 2))
    x, y = (large.places_in[places] + shift).T
    expected = large.places_at(x, y).astype(int)
    expected[(np.abs(shift) > 80 * large.cell_in).any(axis=1) | (expected < 0)] = len(large.places_in)
    np.testing.assert_array_equal(large.beside(places, *shift.T), expected)
    assert (expected < len(large.places_in)).any()


def test_cells_are_connected_as_a_walk_from_cell_to_cell_finds() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        free = rng.random((int(rng.integers(1, 15)), int(rng.integers(1, 15)))) < 0.6
        given = [(int(row), int(column)) for row, column in rng.integers(-2, 15, (3, 2))]
        reached, queue = np.zeros_like(free), [*given]
        while queue:
            row, column = queue.pop()
            if 0 <= row < free.shape[0] and 0 <= column < free.shape[1] and free[row, column] > reached[row, column]:
                reached[row, column] = True
                queue += [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
        np.testing.assert_array_equal(connected(free, given), reached)
