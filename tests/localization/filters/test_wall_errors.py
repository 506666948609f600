"""Noise of ranges in a map whose walls state their accuracy."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.base import with_wall_errors
from localization.filters.sonar_cone import ConeSonar
from worlds.world import Polygon, WallAccuracy, World

WALLS = np.array([(0.0, 0.0, 90.0, 0.0), (0.0, 0.0, 0.0, 30.0)])


def test_variance_of_walls_is_averaged_by_length() -> None:
    world = World("w", inner_walls=WALLS, accuracies={0: WallAccuracy(0.2, 0.0, 90.0), 1: WallAccuracy(0.4, 0.0, 30.0)})
    found = with_wall_errors(ConeSonar(), world)
    assert found.place_var_in2 - ConeSonar().place_var_in2 == pytest.approx(0.75 * 0.2**2 + 0.25 * 0.4**2)
    # All readings from one place repeat it: at any range.
    ranges = np.array((10.0, 100.0))
    np.testing.assert_allclose(found.variance(ranges) - ConeSonar().variance(ranges), 0.07)


def test_walls_without_accuracy_are_exact() -> None:
    assert with_wall_errors(ConeSonar(), World("w", inner_walls=WALLS)) == ConeSonar()
    # Rows of accuracies are those of inner walls, which come after rooms.
    room = Polygon(((-50.0, -50.0), (250.0, -50.0), (250.0, 250.0), (-50.0, 250.0)))
    world = World("w", rooms=(room,), inner_walls=WALLS, accuracies={1: WallAccuracy(0.6, 0.0, 30.0)})
    found = with_wall_errors(ConeSonar(), world)
    assert found.place_var_in2 - ConeSonar().place_var_in2 == pytest.approx(30.0 / 1320.0 * 0.6**2)
