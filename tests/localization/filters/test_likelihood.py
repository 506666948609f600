"""Likelihoods: as densities over all readings, and against a reading by hand."""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np
import pytest

from localization.filters.particles import ConeLikelihood, Likelihood, RayLikelihood
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RangeNoise
from worlds.io import load_world
from worlds.robots import N150

SPAN_IN = 255.0 - 6.0
pytestmark = pytest.mark.long

ROOM = load_world("several_walls").walls
RAYS = RayLikelihood(ROOM, N150, WIRE_SONAR)
CONES = ConeLikelihood(ROOM, N150, ConeSonar())
POSES = np.array([[20.0, 20.0, 0.3], [5.0, 60.0, -2.0], [80.0, 60.0, 1.2], [70.0, 5.0, 0.0]])


@pytest.mark.parametrize("kind", [RAYS, CONES])
@pytest.mark.parametrize("sonar", [0, 5, 11])
def test_likelihood_integrates_to_one(kind: Likelihood, sonar: int) -> None:
    readings = np.arange(-20.0, 300.0, 0.5)
    sums = 0.5 * np.sum([kind.at(POSES, sonar, 0.4, float(reading)).total for reading in readings], axis=0)
    assert (sums >= 0.99).all()
    # Bad readings are spread over less than is summed here.
    assert (sums <= 320.0 / SPAN_IN + 0.01).all()


def test_a_ray_by_hand() -> None:
    pose = np.array([[40.0, 60.0, 0.0]])
    expected = 102.17 - 40.0 - N150.sonar_ring_radius_in
    variance = (0.01 * expected) ** 2 + 1 / 12 + WIRE_SONAR.place_var_in2 + 0.25
    by_hand = 0.95 * exp(-0.5 * (55.0 - expected) ** 2 / variance) / sqrt(2 * pi * variance) + 0.05 / SPAN_IN
    assert RAYS.at(pose, 0, 0.0, 55.0).total[0] == pytest.approx(by_hand)


@pytest.mark.parametrize("kind", [RAYS, CONES])
def test_true_pose_has_highest_likelihood(kind: Likelihood) -> None:
    poses = np.array([[40.0 + off, 60.0, 0.0] for off in (-6.0, -2.0, 0.0, 3.0)])
    assert int(np.argmax(kind.at(poses, 0, 0.0, round(102.17 - 40.0 - N150.sonar_ring_radius_in)).total)) == 2


@pytest.mark.parametrize("kind", [RAYS, CONES])
def test_limits_are_no_ranges(kind: Likelihood) -> None:
    assert [kind.is_range(reading) for reading in (6.0, 7.0, 254.0, 255.0)] == [False, True, True, False]


@pytest.mark.parametrize(("kind", "noise"), [(RAYS, WIRE_SONAR), (CONES, ConeSonar())])
def test_the_widening_counts_as_a_constant_error(kind: Likelihood, noise: RangeNoise) -> None:
    """At 100 in of the noise and of the rounding next to nothing stays, of place and widening, 0.25 in2, all."""
    assert noise.place_var_in2 > 0.0
    constant = 0.25 + noise.place_var_in2 + exp(-4.0 * pi**2) / 12
    variance = (100.0 * noise.range_std_relative) ** 2 + 1 / 12 + 0.25 + noise.place_var_in2
    assert [kind.information(100.0, times) for times in (1, 2, 5)] == pytest.approx(
        [1.0, (variance - 2.0 * constant) / variance, (1.0 - 2.0 * constant / variance) ** 4]
    )
    assert kind.information(10.0, 2) == 0.0


def test_a_ray_into_nothing_leaves_only_bad_readings() -> None:
    alone = RayLikelihood([[50, -10, 50, 10]], N150, WIRE_SONAR)
    assert alone.at(np.array([[0.0, 0.0, pi]]), 0, 0.0, 41.0)[:2] == pytest.approx(np.full((2, 1), 0.05 / SPAN_IN))
    assert np.isnan(alone.at(np.array([[0.0, 0.0, pi]]), 0, 0.0, 41.0).expected_in).all()


@pytest.mark.parametrize("kind", [RAYS, CONES])
def test_far_from_every_echo_only_outliers_remain(kind: Likelihood) -> None:
    """So it is by definition: the part of bad readings does not know what was read, the rest is gone there."""
    near, far = (kind.at(POSES, 3, 0.4, reading_in) for reading_in in (30.0, 5000.0))
    np.testing.assert_allclose(far.total, far.outlier)
    np.testing.assert_array_equal(near.outlier, far.outlier)
    assert (near.total >= near.outlier).all()
