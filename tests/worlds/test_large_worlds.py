"""Large worlds: work in proportion to the corners, the same results as plain computation, and limits by name."""

from __future__ import annotations

import json
import tracemalloc
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WorldFileError
from worlds.geometry import (
    FloatArray,
    candidate_pairs,
    crossing,
    inside,
    nearest_distances,
    nearest_points,
    polygon_segments,
)
from worlds.io import parse_world
from worlds.world import MAX_CORNERS, MAX_PATH_POINTS, MAX_STARTS, Point

seeds = st.integers(0, 2**32)


def star(count: int, seed: int = 1) -> list[Point]:
    """Return an outline of long teeth that does not cross itself."""
    radii = 5000.0 * np.random.default_rng(seed).uniform(0.8, 1.0, count)
    return [
        (round(radius * cos(2 * pi * number / count), 3), round(radius * sin(2 * pi * number / count), 3))
        for number, radius in enumerate(radii.tolist())
    ]


def text_of(corners: list[Point]) -> str:
    return f"[[room]]\ncorners_in = {json.dumps(corners)}\n"


def walls(rng: np.random.Generator, count: int) -> FloatArray:
    """Return short and long, upright, level and slanted walls, some with common ends."""
    first = rng.normal(0.0, 500.0, (count, 2)).round(1)
    along = rng.normal(0.0, 1.0, (count, 2)) * 10.0 ** rng.uniform(-1.0, 2.7, (count, 1))
    along[rng.uniform(size=(count, 2)) < 0.2] = 0.0
    found = np.concatenate((first, first + along), axis=1)
    # Half of the walls begin where another one ends.
    found[1 : count // 2, :2] = found[: count // 2 - 1, 2:]
    return found


@pytest.mark.long
def test_memory_of_a_large_world_is_not_quadratic() -> None:
    text = text_of(star(8000))
    tracemalloc.start()
    try:
        world = parse_world(text, "star.toml", "star")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(world.walls) == 8000
    assert peak < 60e6  # an array of all pairs alone has 64e6 elements


def crossed_pairs(segments: FloatArray) -> set[tuple[int, int]]:
    """Return all pairs of segments that cross, from an array of all pairs."""
    along, ends = segments[:, 2:] - segments[:, :2], segments.reshape(-1, 2)
    offset = ends[np.newaxis] - segments[:, np.newaxis, :2]
    sides = along[:, np.newaxis, 0] * offset[..., 1] - along[:, np.newaxis, 1] * offset[..., 0]
    parted = sides[:, 0::2] * sides[:, 1::2] < 0.0
    return {(one, other) for one, other in np.argwhere(np.triu(parted & parted.T)).tolist()}


@settings(max_examples=25, deadline=None)
@given(seeds, st.integers(65, 250), st.sampled_from([0.0, 3.0, 60.0]))
def test_candidate_pairs_contain_all_that_come_near(seed: int, count: int, reach_in: float) -> None:
    segments = walls(np.random.default_rng(seed), count)
    found = {
        pair
        for one, other in candidate_pairs(segments, reach_in)
        for pair in zip(one.tolist(), other.tolist(), strict=True)
    }
    assert all(one < other for one, other in found)
    # The oracle: the distances of all ends to all walls.
    far = nearest_points(segments.reshape(-1, 2), segments)[1].reshape(count, 2, count).min(axis=1)
    near = {(one, other) for one, other in np.argwhere(np.minimum(far, far.T) <= reach_in).tolist() if one < other}
    assert near | crossed_pairs(segments) <= found


@settings(max_examples=25, deadline=None)
@given(seeds, st.integers(65, 200))
def test_crossing_of_many_edges_agrees_with_all_pairs(seed: int, count: int) -> None:
    segments = walls(np.random.default_rng(seed), count)
    # Shorter segments, so that some sets of them have no crossing at all.
    segments[:, 2:] = segments[:, :2] + 0.15 * (segments[:, 2:] - segments[:, :2])
    pairs = crossed_pairs(segments)
    found = crossing(segments)
    assert (found in pairs) if pairs else found is None


@settings(max_examples=25, deadline=None)
@given(seeds, st.integers(1, 3000))
def test_distances_in_blocks_equal_those_at_once_to_the_bit(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    segments, points = walls(rng, 200), rng.normal(0.0, 600.0, (count, 2))
    # In blocks of neighbouring points, as the function groups them.
    points = points[np.lexsort(points.T // 100.0)]
    assert (nearest_distances(points, segments) == nearest_points(points, segments)[1].min(axis=-1)).all()


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_inside_in_blocks_equals_each_point_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outlines = [polygon_segments(rng.normal(0.0, 9.0, (count, 2)).round(1)) for count in rng.integers(3, 60, 40)]
    edges, firsts = np.concatenate(outlines), np.cumsum([0, *map(len, outlines[:-1])])
    points = rng.normal(0.0, 9.0, (300, 2)).round(1)
    alone = np.array([inside(point, edges, firsts) for point in points])
    assert (inside(points, edges, firsts) == alone).all()
    assert (alone == np.column_stack([inside(points, outline) for outline in outlines])).all()


@pytest.mark.long
def test_edges_that_cross_in_a_large_outline_are_named() -> None:
    corners = star(3000)
    # Two corners that are exchanged make two edges cross.
    corners[10], corners[11] = corners[11], corners[10]
    with pytest.raises(WorldFileError, match=r"room\[0\].corners_in.*cross"):
        parse_world(text_of(corners), "star.toml", "star")


def test_an_outline_too_dense_to_be_checked_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worlds.geometry.MAX_PAIRS", 1000)
    with pytest.raises(WorldFileError, match=r"room\[0\].corners_in.*simpler"):
        parse_world(text_of(star(500)), "star.toml", "star")


SQUARE = "[[room]]\ncorners_in = [[0, 0], [100, 0], [100, 100], [0, 100]]\n"


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "named"),
    [
        (text_of([(0.0, 0.0)] * (MAX_CORNERS + 1)), f"at most {MAX_CORNERS} corners"),
        (SQUARE + "[[start]]\nx_in = 50\ny_in = 50\n" * (MAX_STARTS + 1), f"start: expected at most {MAX_STARTS}"),
        (
            SQUARE + f"[[path]]\nname = 'x'\npoints_in = {[[50, 50]] * (MAX_PATH_POINTS + 1)}\n",
            f"path: expected at most {MAX_PATH_POINTS} points",
        ),
    ],
)
def test_a_world_beyond_a_limit_is_rejected_by_name(text: str, named: str) -> None:
    with pytest.raises(WorldFileError, match=named):
        parse_world(text, "large.toml", "large")
