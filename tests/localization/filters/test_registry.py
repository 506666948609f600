"""The registry of filters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, independent
from localization.filters.odometry import OdometryNoise, with_parameters
from localization.filters.range_table import build_range_table
from localization.filters.registry import METHODS, make, table_search
from worlds.io import load_world
from worlds.robots import N150

KNOWN = LocalizationConfig(load_world("thesis_room").walls, N150)
BELIEF = independent([40.0, 45.0, 0.3], [0.5, 0.5, 0.02])


@pytest.mark.parametrize("method", METHODS)
def test_predicted_leaves_belief_unchanged(method: str) -> None:
    made = make(method, KNOWN, BELIEF, seed=3)
    np.testing.assert_allclose(made.belief.mean[:3], BELIEF.mean, atol=0.1)
    before = made.belief
    ahead = made.predicted(2.0, 0.1)
    assert np.hypot(*(ahead.mean - before.mean)[:2]) == pytest.approx(2.0, abs=0.2)
    np.testing.assert_array_equal(made.belief.mean, before.mean)
    made.predict(2.0, 0.1)
    np.testing.assert_allclose(made.belief.mean, ahead.mean, atol=0.1)


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'kalman'.* ekf"):
        make("kalman", KNOWN, BELIEF)


def test_robots_on_the_same_map_share_its_range_table() -> None:
    config = KNOWN
    one, other = table_search(config), table_search(replace(config, odometry=OdometryNoise(0.0, 0.0, 0.0)))
    assert one.table is other.table
    built = build_range_table(config.walls, N150, config.sonar, config.clearance_in)
    assert (one.table.codes == built.codes).all()
    assert table_search(replace(config, clearance_in=12.0)).table is not one.table


def test_offsets_estimates_the_parameters_of_the_belief() -> None:
    wheels = with_parameters(BELIEF, (0.05,))
    made = make("offsets", KNOWN, Belief(wheels.mean + np.array([0.0, 0.0, 0.0, 0.01]), wheels.cov))
    assert made.belief.mean.tolist() == [40.0, 45.0, 0.3, 0.01, *[0.0] * 20]
    assert made.belief.std[3:7].tolist() == pytest.approx([0.05, 0.0, 0.0, 2.0])
