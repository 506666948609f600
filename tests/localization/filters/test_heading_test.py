"""The test of the heading: against the filter's own likelihoods, and on readings of a robot that turned."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import inf

import numpy as np
import pytest

from localization.filters import registry
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Floats, independent
from localization.filters.ekf import KalmanFilter
from localization.filters.heading_test import MIN_READINGS, READINGS, STEP_RAD, FiredAt, HeadingTest, likelihoods
from localization.filters.health import HealthLimits
from localization.filters.odometry import OdometryNoise
from localization.filters.registry import HEADING_NATS, make
from localization.filters.sonar_cone import ConeModel, ConeSonar, building_sonar, first_echoes, reflectors
from localization.filters.sonar_ray import WIRE_SONAR
from localization.filters.surface import LEVEL_STATES, SurfaceModel, SurfaceUpdate
from localization.filters.update import MeasurementUpdate, Refusal, association_probabilities, linear
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import SurfaceSpot

WALLS = np.asarray(load_world("several_walls").walls)
MODEL = ConeModel(WALLS, N150, ConeSonar(), 2)
TRUTH = (77.36, 71.44, 1.2)
STILL = OdometryNoise(0.0, 0.0, 0.0)


def belief(heading_error: float, std: float = 0.1) -> tuple[Floats, Floats]:
    """Return a mean and a covariance with range parameters, in which heading and position are correlated."""
    x = np.array([TRUTH[0] + 0.1, TRUTH[1] - 0.1, TRUTH[2] + heading_error, 0.05, 0.002])
    root = np.diag([0.2, 0.2, std, 0.1, 0.003])
    root[0, 2] = 0.5 * std
    return x, root @ root.T


def reading(sonar: int, heading: float, model: ConeModel = MODEL) -> float:
    """Return the range of the reflector that a sonar detects most probably; 255 without any."""
    echoes = first_echoes(TRUTH[0], TRUTH[1], heading, 0.0, model.mounts[sonar], model)
    best = max(echoes, key=lambda echo: echo.probability, default=None)
    return float(round(best.range_in)) if best and best.probability > 0.5 else 255.0


def turned(test: HeadingTest, model: ConeModel = MODEL) -> None:
    """Add the readings of a turn of 0.6 rad on the spot that ends at TRUTH, by encoders that began elsewhere."""
    for k in range(32):
        turn = 0.6 * (k - 31) / 31
        pose = (0.1 * k, 3.0, 4.0, 0.7 + turn, 0.7 + turn)
        test.add([pose, pose], [(0.1 * k, k % 16, reading(k % 16, TRUTH[2] + turn, model))])


@pytest.mark.parametrize("std", [0.1, 0.03])
def test_likelihoods_are_those_of_the_filter(std: float) -> None:
    """The encoders moved by an inch to the left of the robot, and turned by 0.2 rad, since the reading."""
    x, P = belief(0.3, std)
    turns = np.array([-0.3, 0.0, 0.2])
    now, before = (10.0, 20.0, 0.5, 0.9), (10.0 + np.sin(0.5), 20.0 - np.cos(0.5), 0.3, 0.6)
    readings = [FiredAt(before, 4, 80.0), FiredAt(now, 0, 22.0), FiredAt(before, 13, 16.0)]
    found = likelihoods(x, P, turns, now, readings, MODEL)
    K = P[:, 2] / P[2, 2]
    cov = P - (P[2, 2] - min(STEP_RAD, std) ** 2) * np.outer(K, K)
    for j, turn in enumerate(turns):
        for k, (at, sonar, reading_in) in enumerate(readings):
            mean = x + K * turn
            if at is before:
                mean[:2] += np.sin(mean[2]), -np.cos(mean[2])
                mean[2] -= 0.2
            association = MODEL.associate(mean.tolist(), cov.tolist(), sonar, at[3] - at[2], reading_in)
            expected = association.likelihood
            if association.refusal is Refusal.NONE:
                corrections = linear(mean.tolist(), cov.tolist(), reading_in, association, association.R)
                _, expected, _ = association_probabilities(association, corrections)
            assert found[k, j] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("error", [-0.35, -0.25, 0.25, 0.35])
def test_finds_the_error_of_a_heading(error: float) -> None:
    test = HeadingTest(MODEL)
    turned(test)
    turn_rad, evidence_nats = test.correction(*belief(error))
    assert turn_rad == pytest.approx(-error, abs=STEP_RAD)
    assert evidence_nats > HEADING_NATS


def test_a_right_heading_stays() -> None:
    test = HeadingTest(MODEL)
    turned(test)
    turn_rad, evidence_nats = test.correction(*belief(0.0))
    assert abs(turn_rad) < STEP_RAD
    assert evidence_nats < HEADING_NATS


@pytest.mark.parametrize("row", range(len(WALLS)))
def test_a_displaced_wall_is_no_heading(row: int) -> None:
    """The readings are those of a room in which one wall stands elsewhere."""
    walls = WALLS.copy()
    walls[row] += 3.0
    test = HeadingTest(MODEL)
    turned(test, ConeModel(walls, N150, ConeSonar(), 2))
    assert test.correction(*belief(0.0))[1] < HEADING_NATS


def test_few_new_readings_are_not_compared() -> None:
    test = HeadingTest(MODEL)
    pose = (0.0, 3.0, 4.0, 0.7, 0.7)
    for k in range(MIN_READINGS - 1):
        test.add([pose, pose], [(0.0, k, 50.0)])
    assert test.correction(*belief(0.3)) == (0.0, 0.0)
    turned(test)
    assert test.correction(*belief(0.3))[1] > 0.0
    assert test.correction(*belief(0.3)) == (0.0, 0.0)
    turned(test)
    test.reset()
    assert test.correction(*belief(0.3)) == (0.0, 0.0)
    assert READINGS >= MIN_READINGS


@pytest.mark.parametrize("method", ["ekf", "iekf", "smoother"])
def test_a_filter_recovers_its_heading(method: str) -> None:
    """Encoders that report nothing of a turn of 0.5 rad: without the test the heading stays off."""
    start = independent(np.add(TRUTH, (0.1, -0.1, 0.5)), (0.2, 0.2, 0.12))
    tested = make(method, LocalizationConfig(WALLS, N150, STILL, ConeSonar()), start)
    plain = KalmanFilter(start, MeasurementUpdate(ConeModel(WALLS, N150, ConeSonar())), STILL, limits=HealthLimits())
    assert isinstance(tested, KalmanFilter)
    pose = (0.0, 3.0, 4.0, 0.7, 0.7)
    for filter_ in (tested, plain):
        for k in range(96):
            filter_.process(pose, [pose, pose], [(0.0, k % 16, reading(k % 16, TRUTH[2]))])
    assert abs(tested.belief.mean[2] - TRUTH[2]) < 0.15
    assert np.hypot(*(tested.belief.mean[:2] - TRUTH[:2])) < 1.0
    assert abs(plain.belief.mean[2] - TRUTH[2]) > 0.25


# Walls with surfaces.

BUILDING = building_sonar(N150.ring)


def spots_of(wall: Floats) -> tuple[SurfaceSpot, ...]:
    """Return spots each 4 in of the first two thirds of a wall, up to 1.5 in to its left or right."""
    length_in = float(np.hypot(*(wall[2:] - wall[:2])))
    along, at = (wall[2:] - wall[:2]) / length_in, np.arange(0.0, 0.67 * length_in, 4.0)
    levels_in = 1.5 * np.sin(at / 5.0)
    places = wall[:2] + np.outer(at, along) + np.outer(levels_in, (-along[1], along[0]))
    return tuple(SurfaceSpot(x, y, 0.15) for x, y in places.tolist())


SPOTS = {row: spots_of(wall) for row, wall in enumerate(WALLS) if row % 2}
"""Of every other wall of the map."""


@pytest.mark.parametrize("std", [0.1, 0.03])
def test_likelihoods_among_surfaces_are_those_of_the_filter(std: float) -> None:
    surfaces = SurfaceModel(ConeModel(WALLS, N150, BUILDING, 2), SPOTS)
    pose, pose_cov = belief(0.3, std)
    # The levels of walls come between pose and range parameters.
    x, P = np.zeros(5 + LEVEL_STATES), BUILDING.surface_std_in**2 * np.eye(5 + LEVEL_STATES)
    own = [0, 1, 2, -2, -1]
    x[own], P[np.ix_(own, own)] = pose, pose_cov
    turns, encoders = np.array([-0.3, 0.0, 0.2]), (10.0, 20.0, 0.5, 0.9)
    K = P[:, 2] / P[2, 2]
    cov = P - (P[2, 2] - min(STEP_RAD, std) ** 2) * np.outer(K, K)
    compared = 0
    for sonar, reading_in in product(range(16), (16.0, 22.0, 30.0, 80.0)):
        (found,) = likelihoods(x, P, turns, encoders, [FiredAt(encoders, sonar, reading_in)], surfaces.cone, surfaces)
        for j, turn in enumerate(turns):
            mean = (x + K * turn).tolist()
            association = surfaces.associate(mean, cov.tolist(), sonar, 0.4, reading_in)
            if association.refusal is Refusal.NONE:
                corrections = linear(mean, cov.tolist(), reading_in, association, association.R)
                _, expected, _ = association_probabilities(association, corrections)
                assert found[j] == pytest.approx(expected, rel=0.05)
                compared += expected > 2.0 * BUILDING.outlier_density
    assert compared > 20


def test_a_repeated_echo_is_compared_once() -> None:
    """The base turns below the turret: after a round of the ring each sonar measures what it has measured before."""
    for surfaces, count in ((None, READINGS), (SurfaceModel(ConeModel(WALLS, N150, BUILDING, 2)), 16)):
        test = HeadingTest(ConeModel(WALLS, N150, BUILDING, 2), surfaces)
        for k in range(40):
            pose = (0.1 * k, 3.0, 4.0, 0.02 * k, 0.7)
            test.add([pose, pose], [(0.1 * k, k % 16, 50.0)])
        assert len(test._recent()) == count
    # Of another sonar along the same axis it is no new one either; from elsewhere it is.
    for turret, x_in, count in ((0.7 + np.radians(22.5), 3.0, 16), (0.7, 4.0, 17)):
        pose = (5.0, x_in, 4.0, 0.8, float(turret))
        test.add([pose, pose], [(5.0, 3, 50.0)])
        assert len(test._recent()) == count


def test_a_filter_among_surfaces_recovers_its_heading() -> None:
    """A robot that drives after a turn of which the encoders report 0.6 rad too little."""
    cone, start = ConeModel(WALLS, N150, BUILDING), (77.0, 71.0, -1.5)
    errors = []
    for limits in (registry._SURFACE_LIMITS, replace(registry._SURFACE_LIMITS, heading_nats=inf)):
        believed = independent(np.add(start, (0.0, 0.0, -0.6)), (0.3, 0.3, 0.2))
        filter_ = KalmanFilter(believed, SurfaceUpdate(SurfaceModel(cone)), STILL, limits=limits)
        before = (0.0, 0.0, 0.0, 0.0, 0.0)
        for k in range(160):
            driven_in = 0.25 * k
            x, y = start[0] + driven_in * np.cos(start[2]), start[1] + driven_in * np.sin(start[2])
            pose = (0.1 * k, driven_in, 0.0, 0.0, 0.0)
            echoes = first_echoes(x, y, start[2], 0.0, cone.mounts[k % 16], cone)
            best = max(echoes, key=lambda echo: echo.probability, default=None)
            range_in = float(round(best.range_in)) if best and best.probability > 0.5 else 255.0
            filter_.process(before, [before, pose], [(pose[0], k % 16, range_in)])
            before = pose
        errors.append(np.abs(filter_.belief.mean - (x, y, start[2])))
    assert errors[0][2] < 0.1
    assert np.hypot(*errors[0][:2]) < 2.5
    assert errors[1][2] > 0.3


def test_rays_and_filters_without_a_limit_have_no_test() -> None:
    start = independent(np.array(TRUTH), (0.2, 0.2, 0.1))
    rays = make("ekf", LocalizationConfig(WALLS, N150, STILL, WIRE_SONAR), start)
    cones = KalmanFilter(start, MeasurementUpdate(MODEL), STILL)
    assert rays._headings is None  # type: ignore[attr-defined]
    assert cones._headings is None


def test_reflectors_within_reach() -> None:
    """By the distance to points along each wall."""
    around = reflectors(WALLS)
    near = around.within(20.0, 20.0, 45.0)
    t = np.linspace(0.0, 1.0, 2001)[:, None, None]
    points = around.walls[:, :2] + t * (around.walls[:, 2:] - around.walls[:, :2])
    nearest_in = np.hypot(*(points - (20.0, 20.0)).transpose(2, 0, 1)).min(axis=0)
    assert near.walls.tolist() == around.walls[nearest_in < 45.0].tolist()
    vertices_in = np.hypot(*(around.vertices - (20.0, 20.0)).T)
    assert near.vertices.tolist() == around.vertices[vertices_in < 45.0].tolist()
    assert 0 < near.count < around.count
