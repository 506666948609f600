"""Reflectors of a map: which ends of walls are vertices, and which of them square corners."""

from __future__ import annotations

import numpy as np

from localization.filters.sonar_cone import reflectors
from worlds.io import load_world


def test_a_square_room_has_four_square_corners() -> None:
    around = reflectors([[0, 0, 10, 0], [10, 0, 10, 10], [10, 10, 0, 10], [0, 10, 0, 0]])
    assert sorted(map(tuple, around.vertices.tolist())) == [(0, 0), (0, 10), (10, 0), (10, 10)]
    assert around.square.all()
    assert around.count == 8


def test_a_wall_that_goes_straight_on_has_no_vertex_there() -> None:
    around = reflectors([[0, 0, 10, 0], [10, 0, 30, 0]])
    assert sorted(map(tuple, around.vertices.tolist())) == [(0, 0), (30, 0)]
    assert not around.square.any()


def test_three_walls_meet_in_a_vertex_that_is_not_square() -> None:
    around = reflectors([[0, 0, 10, 0], [0, 0, 0, 10], [0, 0, -10, -10]])
    at_origin = (around.vertices == 0).all(axis=-1)
    assert at_origin.sum() == 1
    assert not around.square[at_origin].any()


def test_normals_and_lengths_by_hand() -> None:
    around = reflectors([[0, 0, 3, 4]])
    assert around.lengths[0] == 5.0
    np.testing.assert_allclose(around.along, [[0.6, 0.8]])
    np.testing.assert_allclose(around.normals, [[-0.8, 0.6]])


def test_the_tip_of_a_wedge_is_no_square_corner() -> None:
    around = reflectors(load_world("centre_vertex").walls)
    tip = (around.vertices == (45, 20)).all(axis=-1)
    assert tip.sum() == 1
    assert not around.square[tip].any()
