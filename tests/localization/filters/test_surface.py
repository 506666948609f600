"""Walls with a surface: derivatives, information of repeated echoes, and consistency against simulated surfaces."""

from dataclasses import replace
from math import pi, radians

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, independent, unpack, with_constants
from localization.filters.ekf import KalmanFilter
from localization.filters.health import HealthLimits, HealthStatus
from localization.filters.odometry import OdometryNoise
from localization.filters.registry import make
from localization.filters.sonar_cone import BUILDING_SONAR, ConeModel, ConeSonar
from localization.filters.surface import AS_LEARNED, LEVEL_STATES, MAX_LEVELS, SPOT_STD_IN, SurfaceModel, SurfaceUpdate
from localization.filters.update import Refusal
from worlds.rings import Ring
from worlds.robots import N150, Body
from worlds.world import SurfaceSpot, WallAccuracy, World

WALL = np.array([[-500.0, 40.0, 2000.0, 40.0]])
CORRIDOR = np.array([[-500.0, 40.0, 2000.0, 40.0], [-500.0, -40.0, 2000.0, -40.0]])
SONAR = replace(BUILDING_SONAR, rounding_var_in2=0.0)
LEFT, RIGHT = 4, 12
EXACT = OdometryNoise(0.0, 0.0, 0.0)
P = [[4.0, 0.1, 0.02], [0.1, 3.0, 0.01], [0.02, 0.01, 0.001]]


def surface_filter(
    start: list[float], std: list[float], walls: np.ndarray = CORRIDOR, **changes: float
) -> KalmanFilter:
    config = LocalizationConfig(walls, N150, EXACT, replace(SONAR, **changes), range_stds=None)
    made = make("ekf", config, independent(start, std))
    assert isinstance(made, KalmanFilter)
    return made


def with_levels(x: list[float], range_parameters: int) -> tuple[list[float], list[list[float]]]:
    """Return a state with the levels and the range parameters after the pose, and its covariance."""
    stds = [SONAR.surface_std_in] * LEVEL_STATES + [0.5, 0.02][:range_parameters]
    state, cov = unpack(with_constants(Belief(np.array(x), np.array(P)), stds))
    return state, cov


@pytest.mark.parametrize("range_parameters", [0, 2])
def test_derivatives_are_finite_differences(range_parameters: int) -> None:
    x, cov = with_levels([3.0, 2.0, 0.2], range_parameters)
    x[len(x) - range_parameters :] = [0.3, 0.01][:range_parameters]
    model = SurfaceModel(ConeModel(WALL, N150, SONAR, range_parameters))
    SurfaceUpdate(model).apply(x, cov, LEFT, 0.0, 29.0)
    model.move(4.0, 0.1)

    def expected(state: list[float]) -> list[float]:
        return list(model.associate(state, cov, LEFT, -0.05, 28.5).ranges_in)

    found = model.associate(x, cov, LEFT, -0.05, 28.5)
    assert len(found.H) == 2
    for column in range(len(x)):
        step = 1e-5
        ahead, behind = ([*x[:column], x[column] + sign * step, *x[column + 1 :]] for sign in (1, -1))
        slope = [(one - other) / (2 * step) for one, other in zip(expected(ahead), expected(behind), strict=True)]
        assert [row[column] for row in found.H] == pytest.approx(slope, abs=1e-6)


def test_probabilities_follow_the_distance() -> None:
    """Oracle: exp(-distance / length) on the same level, the rest on a new one."""
    model = SurfaceModel(ConeModel(WALL, N150, replace(SONAR, surface_length_in=20.0)))
    x, cov = with_levels([0.0, 0.0, 0.0], 0)
    alone = model.associate(x, cov, LEFT, 0.0, 30.9).probability[0]
    SurfaceUpdate(model).apply(x, cov, LEFT, 0.0, 30.9)
    model.move(5.0, 0.0)
    same, new = model.associate([5.0, *x[1:]], cov, LEFT, 0.0, 30.9).probability
    assert same / new == pytest.approx(np.exp(-0.25) / (1.0 - np.exp(-0.25)))
    assert same + new == pytest.approx(alone, rel=1e-3)


def test_the_update_is_the_posterior_over_both_levels() -> None:
    """Oracle: weighted samples of the position and of both levels, for a reading that either may explain."""
    sonar = replace(SONAR, outlier_probability=0.2, cone_loss_db=0.0, margin_db=200.0)
    x, cov = with_levels([0.0, 0.0, 0.0], 0)
    cov[0][0] = cov[2][2] = 0.0
    for other in range(len(x)):
        if other != 1:
            cov[1][other] = cov[other][1] = 0.0
    model = SurfaceModel(ConeModel(WALL, N150, sonar))
    update = SurfaceUpdate(model)
    update.apply(x, cov, LEFT, 0.0, 31.5)
    model.move(10.0, 0.0)
    level, same = 3, np.exp(-10.0 / sonar.surface_length_in)
    # 1. Samples of y, level and new level, each with the level that follows, and an outlier.
    rng = np.random.default_rng(1)
    y, b = rng.multivariate_normal([x[1], x[level]], np.array(cov)[np.ix_([1, level], [1, level])], 400_000).T
    new = sonar.surface_std_in * rng.standard_normal(len(y))
    reading, ring_in = 33.2, N150.sonar_ring_radius_in
    r = (sonar.range_std_relative * (40.0 - x[1] - ring_in)) ** 2

    def density(expected: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * (reading - expected) ** 2 / r) / np.sqrt(2 * np.pi * r))

    inlier = 1.0 - sonar.outlier_probability
    weights = np.concatenate((
        inlier * same * density(40.0 - y - ring_in + b),
        inlier * (1.0 - same) * density(40.0 - y - ring_in + new),
        np.full(len(y), sonar.outlier_probability * sonar.outlier_density),
    ))  # fmt: skip
    samples = np.stack((np.tile(y, 3), np.concatenate((b, new, b))))
    # 2. The filter.
    update.apply(x, cov, LEFT, 0.0, reading)
    assert [x[1], x[level]] == pytest.approx(np.average(samples, axis=1, weights=weights), abs=0.02)
    expected = np.cov(samples, aweights=weights)
    assert np.array(cov)[np.ix_([1, level], [1, level])] == pytest.approx(expected, rel=0.03)


def test_echoes_along_one_level_measure_the_heading() -> None:
    """Oracle: least squares of all readings at once, for the lateral position, the heading and the level."""
    rng = np.random.default_rng(3)
    localizer = surface_filter(
        [0.0] * 3, [0.0, 1.0, 0.05], WALL, surface_length_in=1e9, outlier_probability=0.0, range_std_relative=0.003
    )
    ring_in, level, heading, y = N150.sonar_ring_radius_in, 1.2, 0.01, -0.4
    rows, readings = [], []
    for k in range(1, 25):
        localizer.predict(5.0, 0.0)
        range_in = 40.0 - y - 5.0 * k * np.sin(heading) - ring_in * np.cos(heading)
        r = 0.003 * range_in
        readings.append((range_in + level + r * rng.standard_normal() - (40.0 - ring_in)) / r)
        rows.append(np.array([-1.0, -5.0 * k, 1.0]) / r)
        localizer.update(LEFT, 0.0, float(readings[-1] * r + 40.0 - ring_in))
    prior = np.diag(1.0 / np.square([1.0, 0.05, SONAR.surface_std_in]))
    cov = np.linalg.inv(prior + np.array(rows).T @ np.array(rows))
    mean = cov @ (np.array(rows).T @ np.array(readings))
    assert localizer.belief.mean[1] - 120.0 * np.sin(mean[1]) == pytest.approx(mean[0], abs=0.03)
    assert localizer.belief.mean[2] == pytest.approx(mean[1], abs=0.1 * np.sqrt(cov[1, 1]))
    assert localizer.belief.cov[2, 2] == pytest.approx(cov[1, 1], rel=0.05)


def test_more_walls_than_levels_are_measured_in_turn() -> None:
    angles = 2 * pi * np.arange(MAX_LEVELS + 4) / (MAX_LEVELS + 4)
    corners = 60.0 * np.column_stack((np.cos(angles), np.sin(angles)))
    walls = np.hstack((corners, np.roll(corners, -1, axis=0)))
    localizer = surface_filter([0.0, 0.0, 0.0], [0.5, 0.5, 0.01], walls, outlier_probability=0.1)
    apothem = 60.0 * np.cos(pi / len(angles))
    for _ in range(3):
        for number in range(16):
            localizer.predict(0.3, 0.0)
            localizer.update(number, 0.0, apothem - N150.sonar_ring_radius_in)
    state = localizer.state
    assert len(state.mean) == 3 + LEVEL_STATES
    assert np.linalg.eigvalsh(state.cov).min() > -1e-12
    assert localizer.belief.std[0] < 0.5


def test_free_ends_of_walls_are_no_reflectors_in_buildings() -> None:
    """A corner of two walls is a reflector; a wall's end on a map may be the end of what was mapped."""
    walls = np.array([[0.0, 0.0, 100.0, 0.0], [100.0, 0.0, 100.0, 50.0]])
    assert [vertex[:2] for vertex in ConeModel(walls, N150, SONAR).vertices] == [[100.0, 0.0]]
    assert len(ConeModel(walls, N150, replace(SONAR, surface_std_in=0.0)).vertices) == 3


@pytest.mark.long
def test_a_standing_robot_learns_from_one_echo_only() -> None:
    localizer = surface_filter([0.0, 0.0, 0.0], [2.0, 2.0, 0.01])
    localizer.update(LEFT, 0.0, 30.9)
    once = localizer.belief.cov[1, 1]
    for _ in range(200):
        localizer.update(LEFT, 0.0, 30.9)
    assert localizer.belief.cov[1, 1] == pytest.approx(once, rel=1e-6)


def test_an_echo_along_the_same_axis_after_a_turn_below_the_turret_tells_nothing_new() -> None:
    localizer = surface_filter([0.0, 0.0, 0.0], [2.0, 2.0, 0.2])
    localizer.update(LEFT, 0.0, 33.0)
    for turned in (0.5, 1.0):
        localizer.predict(0.0, 0.5)
        before = localizer.belief
        localizer.update(LEFT, -turned, 33.0)
        np.testing.assert_array_equal(localizer.belief.mean, before.mean)
        np.testing.assert_array_equal(localizer.belief.cov, before.cov)
    # Along another axis it does.
    localizer.update(LEFT, -1.0 + radians(11.0), 33.0)
    assert localizer.belief.cov[1, 1] < before.cov[1, 1]


def test_echoes_of_one_level_are_one_measurement_of_the_wall() -> None:
    """Oracle: n readings with the common error c of the level and own errors r have the variance c^2 + r^2 / n."""
    localizer = surface_filter([0.0, 0.0, 0.0], [0.0, 50.0, 0.0], WALL, surface_length_in=1e9, outlier_probability=0.0)
    c = SONAR.surface_std_in
    for _ in range(30):
        localizer.predict(5.0, 0.0)
        localizer.update(LEFT, 0.0, 30.9)
    assert localizer.belief.cov[1, 1] == pytest.approx(c * c, rel=0.02)
    assert localizer.belief.cov[1, 1] >= c * c * (1 - 1 / 400)


def levels(rng: np.random.Generator, steps: int, step_in: float, std_in: float, length_in: float) -> np.ndarray:
    """Return the level of a surface at each step of a drive: redrawn with the probability of a Poisson event."""
    found, level = [], std_in * rng.standard_normal()
    for _ in range(steps):
        if rng.random() > np.exp(-step_in / length_in):
            level = std_in * rng.standard_normal()
        found.append(level)
    return np.array(found)


def drive(seed: int, sonar: ConeSonar) -> tuple[float, float, list[HealthStatus]]:
    """Return NEES of y, error of y and health at the end of a drive along a corridor whose walls have levels."""
    rng = np.random.default_rng(seed)
    noise, steps, step_in = OdometryNoise(0.0, 0.0, 0.005), 40, 5.0
    left, right = (levels(rng, steps, step_in, 1.5, 24.0) for _ in range(2))
    start = rng.standard_normal(3) * (0.5, 1.0, 0.02)
    config = LocalizationConfig(CORRIDOR, N150, noise, sonar, range_stds=None)
    localizer = make("ekf", config, independent(start, [0.5, 1.0, 0.02]))
    x = y = heading = 0.0
    health = []
    for k in range(steps):
        turn = 0.005 * np.sqrt(step_in) * rng.standard_normal()
        x, y = x + step_in * np.cos(heading + turn / 2), y + step_in * np.sin(heading + turn / 2)
        heading += turn
        localizer.predict(step_in, 0.0)
        ring_in = N150.sonar_ring_radius_in
        for sonar_number, level, side in ((LEFT, left[k], 1.0), (RIGHT, right[k], -1.0)):
            face_y = y + ring_in * np.sin(heading + side * pi / 2)
            reading = 40.0 - side * face_y + level + 0.003 * 30 * rng.standard_normal()
            localizer.update(sonar_number, 0.0, float(reading))
        health.append(localizer.health.status)
    error = localizer.belief.mean[1] - y
    return error**2 / localizer.belief.cov[1, 1], error, health


@pytest.mark.long
def test_the_filter_is_consistent_on_simulated_surfaces() -> None:
    """Oracle: the true position of a Monte Carlo simulation; a filter for plane walls is overconfident there."""
    sonar = replace(SONAR, surface_std_in=1.5)
    results = [drive(seed, sonar) for seed in range(40)]
    plane = [drive(seed, replace(sonar, surface_std_in=0.0)) for seed in range(40)]
    assert 0.3 < np.mean([nees for nees, _, _ in results]) < 2.0
    assert np.mean([nees for nees, _, _ in plane]) > 4.0
    rms, plane_rms = (np.sqrt(np.mean([error**2 for _, error, _ in each])) for each in (results, plane))
    assert rms < 1.1 * plane_rms
    assert {status for _, _, health in results for status in health} == {HealthStatus.OK}


def test_echoes_of_things_off_the_map_are_no_reason_for_doubt() -> None:
    ring = Ring(9.06, (0.0, radians(90.0)), ((0,), (1,)), 0.06, 6.0, 255.0, 1.0, 255.0)
    config = LocalizationConfig(CORRIDOR, Body("two", 9.0, ring, ()), EXACT, SONAR, range_stds=None)
    localizer = make("ekf", config, independent([0.0, 0.0, 0.0], [0.5, 0.5, 0.01]))
    for k in range(100):
        localizer.predict(2.0, 0.0)
        assert localizer.update(0, 0.0, 50.0 + k).refusal is Refusal.NO_WALL
        assert localizer.update(1, 0.0, 30.9).refusal is Refusal.NONE
    assert localizer.health.status is HealthStatus.OK


def test_echoes_that_contradict_the_map_are_a_reason_for_doubt() -> None:
    localizer = surface_filter([0.0, 0.0, 0.0], [0.5, 0.5, 0.01])
    for _ in range(100):
        localizer.predict(2.0, 0.0)
        localizer.update(LEFT, 0.0, 70.0)
        localizer.update(RIGHT, 0.0, 12.0)
    assert localizer.health.status is HealthStatus.DEGRADED


def test_limits_of_the_monitor_are_those_given() -> None:
    """A position known to 5 in along a corridor is good in a building, by its own limits."""
    start, std = [0.0, 0.0, 0.0], [5.0, 0.5, 0.01]
    assert surface_filter(start, std).health.status is HealthStatus.OK
    measurement = SurfaceUpdate(SurfaceModel(ConeModel(CORRIDOR, N150, SONAR)))
    strict = KalmanFilter(independent(start, std), measurement, EXACT, limits=HealthLimits(max_std_in=4.0))
    assert strict.health.status is HealthStatus.DEGRADED


def test_other_sonars_have_no_surface() -> None:
    config = LocalizationConfig(CORRIDOR, N150, EXACT, ConeSonar())
    localizer = make("ekf", config, independent([0.0, 0.0, 0.0], [0.5, 0.5, 0.01]))
    assert isinstance(localizer, KalmanFilter)
    assert not localizer._measurement.level_stds


def test_the_end_of_a_wall_on_the_map_need_not_be_detected() -> None:
    """An echo beyond the only edge in the cone says nothing of the pose, though the map expects the edge."""
    walls = np.array([[-50.0, 40.0, 30.0, 12.0]])
    config = LocalizationConfig(walls, N150, EXACT, SONAR, range_stds=None)
    localizer = make("ekf", config, independent([0.0, 0.0, 0.0], [0.1, 0.1, 0.01]))
    assert localizer.update(1, 0.0, 150.0).refusal is Refusal.NO_WALL
    assert localizer.update(0, 0.0, 150.0).refusal is Refusal.NO_WALL


# Learned surfaces.

LEARNED = (SurfaceSpot(1.0, 41.5, 0.3), SurfaceSpot(5.0, 38.0, 0.1), SurfaceSpot(30.0, 40.0, 0.1))


@pytest.mark.parametrize(
    ("x", "sonar", "y", "level"),
    [(0.0, LEFT, 0.0, 1.5), (2.9, LEFT, 0.0, 1.5), (4.0, LEFT, 0.0, -2.0), (1.0, RIGHT, 80.0, -1.5)],
)
def test_echo_of_a_learned_spot_is_expected_at_its_level(x: float, sonar: int, y: float, level: float) -> None:
    """Oracle: the distance of the spot from the face of the sonar, on either side of the wall."""
    model = SurfaceModel(ConeModel(WALL, N150, SONAR), {0: LEARNED})
    state, cov = with_levels([x, y, 0.0], 0)
    plane = 40.0 - N150.sonar_ring_radius_in
    found = model.associate(state, cov, sonar, 0.0, plane + level)
    assert found.ranges_in == pytest.approx([plane + level, plane])
    spot = 0.1 if level == -2.0 else 0.3
    assert found.R[0] == pytest.approx(found.R[1] + spot**2 + SPOT_STD_IN**2)
    assert found.probability[0] / sum(found.probability) == pytest.approx(AS_LEARNED)


@pytest.mark.parametrize("x", [-2.0, 8.0, 20.0, 34.0])
def test_elsewhere_a_surface_is_unknown(x: float) -> None:
    model, plain = SurfaceModel(ConeModel(WALL, N150, SONAR), {0: LEARNED}), SurfaceModel(ConeModel(WALL, N150, SONAR))
    state, cov = with_levels([x, 0.0, 0.0], 0)
    found, expected = (each.associate(state, cov, LEFT, 0.0, 31.0) for each in (model, plain))
    assert (found.ranges_in, found.R, found.probability) == (expected.ranges_in, expected.R, expected.probability)


def test_derivatives_of_a_learned_surface_are_finite_differences() -> None:
    x, cov = with_levels([1.5, 2.0, 0.05], 2)
    x[-2:] = 0.3, 0.01
    model = SurfaceModel(ConeModel(WALL, N150, SONAR, 2), {0: LEARNED})
    SurfaceUpdate(model).apply(x, cov, LEFT, 0.0, 29.0)
    found = model.associate(x, cov, LEFT, 0.0, 28.5)
    assert len(found.H) == 3
    for column in range(len(x)):
        step = 1e-5
        ahead, behind = ([*x[:column], x[column] + sign * step, *x[column + 1 :]] for sign in (1, -1))
        one, other = (model.associate(state, cov, LEFT, 0.0, 28.5).ranges_in for state in (ahead, behind))
        slope = [(a - b) / (2 * step) for a, b in zip(one, other, strict=True)]
        assert [row[column] for row in found.H] == pytest.approx(slope, abs=1e-6)


def test_a_learned_surface_tells_the_distance_of_a_wall() -> None:
    """A wall that stands 3 in out where it was learned: with its surface the position is right, without 3 in off."""
    surface = tuple(SurfaceSpot(float(x), 37.0, 0.1) for x in range(-40, 240, 4))
    corridor = World("corridor", inner_walls=CORRIDOR, accuracies={0: WallAccuracy(0.0001, 0.0, 90.0, surface)})
    config = LocalizationConfig.in_world(corridor, N150, EXACT, SONAR)
    errors = []
    for known in (config, replace(config, surfaces={})):
        localizer = make("ekf", replace(known, range_stds=None), independent([0.0, 0.0, 0.0], [0.5, 2.0, 0.01]))
        for _ in range(50):
            localizer.predict(2.0, 0.0)
            localizer.update(LEFT, 0.0, 37.0 - N150.sonar_ring_radius_in)
        errors.append(abs(float(localizer.belief.mean[1])))
    assert errors[0] < 0.2
    assert errors[1] > 1.0


def test_beyond_learned_spots_the_level_is_a_new_one() -> None:
    """A level of +1 in before a learned stretch says nothing of the wall behind it."""
    surface = tuple(SurfaceSpot(float(x), 38.0, 0.1) for x in range(2, 40, 4))
    model = SurfaceModel(ConeModel(WALL, N150, SONAR), {0: surface})
    x, cov = with_levels([-20.0, 0.0, 0.0], 0)
    cov = (np.array(cov) * np.outer(*[np.where(np.arange(len(x)) < 3, 0.01, 1.0)] * 2)).tolist()
    update = SurfaceUpdate(model)
    plane = 40.0 - N150.sonar_ring_radius_in
    for _ in range(30):
        x[0] += 2.0
        model.move(2.0, 0.0)
        update.apply(x, cov, LEFT, 0.0, plane + (-2.0 if x[0] > 0.0 else 1.0))
    assert x[0] == pytest.approx(40.0, abs=0.5)
    level = 3 + model._levels[0].number
    assert abs(x[level]) < 0.5
    assert cov[level][level] ** 0.5 > 1.0


def test_echo_of_a_learned_spot_far_beside_its_wall_is_accepted() -> None:
    """A door that stands back by 9 in, at the edge of the cone, where the map expects hardly any echo of the plane."""
    spots = tuple(SurfaceSpot(float(x), 49.0, 0.1) for x in range(-40, 44, 4))
    x, cov = with_levels([0.0, 0.0, 0.4365], 0)
    cov = (1e-4 * np.array(cov)).tolist()
    reading = 49.0 - N150.sonar_ring_radius_in * np.cos(0.4365)
    learned, plain = (SurfaceModel(ConeModel(WALL, N150, SONAR), surfaces) for surfaces in ({0: spots}, {0: ()}))
    assert learned.associate(x, cov, LEFT, 0.0, reading).refusal is Refusal.NONE
    assert plain.associate(x, cov, LEFT, 0.0, reading).refusal is Refusal.NO_WALL
