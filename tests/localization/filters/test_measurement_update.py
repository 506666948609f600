"""The update by single readings: reasons of refusal, and corrections by rays and cones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.base import measurement_model
from localization.filters.belief import Belief, independent
from localization.filters.ekf import update_ring
from localization.filters.odometry import with_parameters
from localization.filters.registry import update_for
from localization.filters.sonar_cone import ConeModel, ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RayModel, RaySonar, observe_ring, wall_map
from localization.filters.ukf import unscented
from localization.filters.update import MeasurementUpdate, Refusal, Rule, iterated
from worlds.io import load_world
from worlds.robots import N150

ROOM = load_world("thesis_room").walls
BELIEF = independent([40.0, 45.0, 0.0], [0.5, 0.5, 0.02])
EAST_IN = 102.17 - 40.0 - N150.sonar_ring_radius_in
CONE, RAYS = update_for(ROOM, N150, ConeSonar()), update_for(ROOM, N150, WIRE_SONAR)


def test_the_type_of_sonar_selects_the_model() -> None:
    assert isinstance(measurement_model(ROOM, N150, ConeSonar()), ConeModel)
    assert isinstance(measurement_model(ROOM, N150, WIRE_SONAR), RayModel)


@pytest.mark.parametrize("measurement", [CONE, RAYS])
def test_a_good_reading_corrects(measurement: MeasurementUpdate) -> None:
    after, result = measurement.updated(BELIEF, 0, 0.0, 54.0)
    assert result.refusal is Refusal.NONE
    assert result.innovation_in == pytest.approx(54.0 - EAST_IN)
    assert after.mean[0] < BELIEF.mean[0]
    assert after.std[0] < BELIEF.std[0]
    assert 0.0 < result.nis < 6.6
    assert result.outlier_probability < 0.1


@pytest.mark.parametrize("measurement", [CONE, RAYS])
@pytest.mark.parametrize(("reading", "refusal"), [(6.0, Refusal.LIMIT), (255.0, Refusal.LIMIT), (90.0, Refusal.GATE)])
def test_bad_readings_are_refused(measurement: MeasurementUpdate, reading: float, refusal: Refusal) -> None:
    after, outcome = measurement.updated(BELIEF, 0, 0.0, reading)
    assert outcome.refusal is refusal
    assert outcome.outlier_probability > 0.99
    np.testing.assert_allclose(after.mean, BELIEF.mean, atol=1e-6)


def test_a_cone_without_reflectors_changes_nothing() -> None:
    after, outcome = CONE.updated(BELIEF, 1, math.radians(0.0), 100.0)
    assert outcome.refusal is Refusal.NO_WALL
    np.testing.assert_array_equal(after.mean, BELIEF.mean)
    np.testing.assert_array_equal(after.cov, BELIEF.cov)


def test_the_turret_turns_the_ring() -> None:
    turned, _ = CONE.updated(BELIEF, 1, -math.tau / 16, 54.0)
    ahead, _ = CONE.updated(BELIEF, 0, 0.0, 54.0)
    np.testing.assert_allclose(turned.mean, ahead.mean, atol=1e-9)


def test_single_ray_update_equals_ring_update() -> None:
    angle = np.array([0.2 + N150.sonar_angles_rad[3]])
    for reading in (40.0, 52.0, 71.0):
        after, outcome = RAYS.updated(BELIEF, 3, 0.2, reading)
        seen = observe_ring(BELIEF, angle, np.array([reading]), N150, wall_map(ROOM), WIRE_SONAR)
        expected, _ = update_ring(BELIEF, seen)
        assert outcome.refusal is seen.reasons()[0]
        np.testing.assert_allclose(after.mean, expected.mean, atol=1e-12)
        np.testing.assert_allclose(after.cov, expected.cov, atol=1e-12)


@pytest.mark.parametrize("measurement", [CONE, RAYS])
def test_longer_states_are_corrected_whole(measurement: MeasurementUpdate) -> None:
    longer = with_parameters(BELIEF, (0.05,))
    cov = longer.cov.copy()
    cov[0, 3] = cov[3, 0] = 0.02
    after, _ = measurement.updated(Belief(longer.mean, cov), 0, 0.0, 54.0)
    assert after.mean.shape == (4,)
    assert after.mean[3] == pytest.approx(0.02 / 0.25 * (after.mean[0] - BELIEF.mean[0]), rel=1e-6)
    assert after.pose.mean.shape == (3,)


@pytest.mark.parametrize("sonar", [ConeSonar(), WIRE_SONAR])
@pytest.mark.parametrize("rule", [iterated, unscented])
def test_with_little_uncertainty_all_rules_agree(sonar: ConeSonar | RaySonar, rule: Rule) -> None:
    sure = independent([40.0, 45.0, 0.0], [0.05, 0.05, 0.002])
    for number in range(16):
        plain, plain_outcome = update_for(ROOM, N150, sonar).updated(sure, number, 0.1, 54.0)
        other, other_outcome = update_for(ROOM, N150, sonar, rule=rule).updated(sure, number, 0.1, 54.0)
        assert other_outcome.refusal is plain_outcome.refusal
        np.testing.assert_allclose(other.mean, plain.mean, atol=1e-3)
        np.testing.assert_allclose(other.cov, plain.cov, atol=1e-5)
        assert other_outcome.likelihood == pytest.approx(plain_outcome.likelihood, rel=0.02)
