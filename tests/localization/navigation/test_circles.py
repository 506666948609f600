"""Circles around wall ends and their tangents: against points sampled along the circles."""

from __future__ import annotations

from math import pi, tau

import numpy as np
import pytest

from localization.navigation.path import wall_distances
from localization.navigation.roadmap import CornerCircle, common_tangents, points_on_circles, tangents_from
from worlds.geometry import nearest_points
from worlds.io import load_world

RADIUS_IN = 11.0


@pytest.mark.parametrize("world", ["several_walls", "centre_vertex"])
def test_arcs_are_free_where_every_point_of_them_is(world: str) -> None:
    walls, rng = np.array(load_world(world).walls), np.random.default_rng(1)
    seen = set()
    # Circles around each end of a wall, cut at nine random angles.
    for centre in np.unique(walls.reshape(-1, 2), axis=0):
        rim, angles = CornerCircle(centre, walls, RADIUS_IN), np.sort(rng.uniform(0.0, tau, 9))
        for free, first, last in zip(rim.free(angles), angles, np.append(angles[1:], angles[0] + tau), strict=True):
            # 2001 points of the arc decide whether it is free.
            turns = np.linspace(first, last, 2001)
            points = centre + RADIUS_IN * np.stack((np.cos(turns), np.sin(turns)), axis=-1)
            assert free == (wall_distances(points, walls).min() >= RADIUS_IN - 1e-4)
            seen.add(free)
    assert seen == {True, False}


def test_free_angles_at_end_of_single_wall() -> None:
    wall = np.array([[0.0, 0.0, 50.0, 0.0]])
    assert CornerCircle(np.array([0.0, 0.0]), wall, 10.0).free(np.array([pi])) == [False]
    assert CornerCircle(np.array([0.0, 0.0]), wall, 10.0).free(np.array([0.5 * pi + 0.01, 1.5 * pi - 0.01])) == [
        True,
        False,
    ]
    point = np.array([[0.0, 0.0, 0.0, 0.0]])
    assert CornerCircle(np.array([0.0, 0.0]), point, 10.0).free(np.array([1.0])) == [True]


def test_tangents_touch_both_circles_and_cut_neither() -> None:
    # Two far pairs with four tangents each, one overlapping pair with two.
    centres = np.array([[0.0, 0.0], [50.0, 10.0], [60.0, 0.0]])
    angles, circles, kinds = common_tangents(centres, np.array([[0, 1], [0, 2], [1, 2]]), RADIUS_IN)
    assert len(angles) == 4 + 4 + 2
    assert len({(*pair, kind) for pair, kind in zip(circles.tolist(), kinds.tolist(), strict=True)}) == len(angles)
    ends = [points_on_circles(centres, circles[:, k], angles[:, k], RADIUS_IN) for k in (0, 1)]
    segments = np.concatenate(ends, axis=1)
    # Each tangent ends at both circles, and cuts neither.
    for k in (0, 1):
        _, far = nearest_points(centres, segments)
        touched = far[circles[:, k], np.arange(len(segments))]
        np.testing.assert_allclose(touched, RADIUS_IN, atol=1e-9)


def test_tangents_are_perpendicular_and_none_from_inside() -> None:
    centres, point = np.array([[0.0, 0.0], [50.0, 10.0]]), np.array([5.0, 0.0])
    angles, circles = tangents_from(point, centres, RADIUS_IN)
    assert circles.tolist() == [1, 1]
    for touch, centre in zip(points_on_circles(centres, circles, angles, RADIUS_IN), centres[circles], strict=True):
        assert np.dot(touch - centre, touch - point) == pytest.approx(0.0, abs=1e-9)


def test_without_walls_there_is_all_the_room() -> None:
    assert wall_distances(np.zeros((2, 2)), np.zeros((0, 4))).tolist() == [np.inf, np.inf]
