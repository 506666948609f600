"""Readings taken in one by one: what is refused and why, and that rays and cones learn where they can."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.base import measurement_model
from localization.filters.belief import Belief, independent
from localization.filters.ekf import correct
from localization.filters.odometry import pose_of, with_parameters
from localization.filters.registry import update_for
from localization.filters.sonar_cone import ConeModel, ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RayModel, RaySonar, observe, pick, ring, wall_map
from localization.filters.update import MeasurementUpdate, Refusal, Rule, iterated, unscented
from worlds.io import load_world
from worlds.robots import N150

ROOM = load_world("thesis_room").walls
BELIEF = independent([40.0, 45.0, 0.0], [0.5, 0.5, 0.02])
EAST_IN = 102.17 - 40.0 - N150.sonar_ring_radius_in
CONE, RAYS = update_for(ROOM, N150, ConeSonar()), update_for(ROOM, N150, WIRE_SONAR)


def test_the_kind_of_sonar_says_how_it_is_heard() -> None:
    assert isinstance(measurement_model(ROOM, N150, ConeSonar()), ConeModel)
    assert isinstance(measurement_model(ROOM, N150, WIRE_SONAR), RayModel)


@pytest.mark.parametrize("hearing", [CONE, RAYS])
def test_a_good_reading_corrects(hearing: MeasurementUpdate) -> None:
    heard = hearing.hear(BELIEF, 0, 0.0, 54.0)
    assert heard.judgement.refusal is Refusal.NONE
    assert heard.judgement.innovation_in == pytest.approx(54.0 - EAST_IN)
    assert heard.belief.mean[0] < BELIEF.mean[0]
    assert heard.belief.std[0] < BELIEF.std[0]
    assert 0.0 < heard.judgement.nis < 6.6
    assert heard.judgement.outlier_probability < 0.1


@pytest.mark.parametrize("hearing", [CONE, RAYS])
@pytest.mark.parametrize(("reading", "refusal"), [(6.0, Refusal.LIMIT), (255.0, Refusal.LIMIT), (90.0, Refusal.GATE)])
def test_bad_readings_are_told_apart(hearing: MeasurementUpdate, reading: float, refusal: Refusal) -> None:
    heard = hearing.hear(BELIEF, 0, 0.0, reading)
    assert heard.judgement.refusal is refusal
    assert heard.judgement.outlier_probability > 0.99
    np.testing.assert_allclose(heard.belief.mean, BELIEF.mean, atol=1e-6)


def test_a_cone_that_no_reflector_fills_says_so() -> None:
    heard = CONE.hear(BELIEF, 1, math.radians(0.0), 100.0)
    assert heard.judgement.refusal is Refusal.NO_WALL
    assert heard.belief is BELIEF


def test_the_turret_turns_the_ring() -> None:
    turned = CONE.hear(BELIEF, 1, -math.tau / 16, 54.0)
    ahead = CONE.hear(BELIEF, 0, 0.0, 54.0)
    np.testing.assert_allclose(turned.belief.mean, ahead.belief.mean, atol=1e-9)


def test_a_ray_is_the_gate_and_the_filter_of_the_experiments() -> None:
    heard = RAYS.hear(BELIEF, 3, 0.2, 40.0)
    seen = observe(BELIEF, pick(ring(N150, 0.2), 3), np.array([40.0]), wall_map(ROOM), WIRE_SONAR)
    assert heard.judgement.refusal is seen.reasons()[0]
    np.testing.assert_allclose(heard.belief.mean, correct(BELIEF, seen).mean, atol=1e-12)


@pytest.mark.parametrize("hearing", [CONE, RAYS])
def test_longer_states_are_corrected_whole(hearing: MeasurementUpdate) -> None:
    longer = with_parameters(BELIEF, (0.05,))
    cov = longer.cov.copy()
    cov[0, 3] = cov[3, 0] = 0.02
    heard = hearing.hear(Belief(longer.mean, cov), 0, 0.0, 54.0)
    assert heard.belief.mean.shape == (4,)
    assert heard.belief.mean[3] == pytest.approx(0.02 / 0.25 * (heard.belief.mean[0] - BELIEF.mean[0]), rel=1e-6)
    assert pose_of(heard.belief).mean.shape == (3,)


@pytest.mark.parametrize("sonar", [ConeSonar(), WIRE_SONAR])
@pytest.mark.parametrize("rule", [iterated, unscented])
def test_where_little_is_uncertain_all_rules_are_the_extended_filter(sonar: ConeSonar | RaySonar, rule: Rule) -> None:
    sure = independent([40.0, 45.0, 0.0], [0.05, 0.05, 0.002])
    for number in range(16):
        plain = update_for(ROOM, N150, sonar).hear(sure, number, 0.1, 54.0)
        other = update_for(ROOM, N150, sonar, rule=rule).hear(sure, number, 0.1, 54.0)
        assert other.judgement.refusal is plain.judgement.refusal
        np.testing.assert_allclose(other.belief.mean, plain.belief.mean, atol=1e-3)
        np.testing.assert_allclose(other.belief.cov, plain.belief.cov, atol=1e-5)
        assert other.likelihood == pytest.approx(plain.likelihood, rel=0.02)
