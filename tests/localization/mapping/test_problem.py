"""Residuals and normal equations of a map: finite differences, another solver, the free frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.stats import norm

from localization.filters.belief import Floats, rotate, wrap_angle
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.measurements import Trajectory, build_trajectory
from localization.mapping.problem import (
    BEARING_COST,
    HALF_CONE_RAD,
    LEVEL_CELL_IN,
    NO_FEATURE,
    NO_LEVEL,
    RIGHT_ANGLE_STD_RAD,
    ROBUST_LIMIT,
    SAME_LEVEL_STD_IN,
    SQUARE_STD_RAD,
    WALL_BEARING_STD_RAD,
    Assignment,
    Levels,
    MapProblem,
    MapState,
    Reflection,
    predict_point,
    predict_wall,
    robust_cost,
    robust_weight,
    sensors_at,
)
from localization.mapping.solver import NormalEquations
from tests.localization.mapping.drives import drive

NOISE = OdometryNoise(0.05, 0.05, 0.002)
NODES = 12
# Walls and corners of the room in the frame of the first pose, (25, 25) and heading 0.
WALLS = np.array([[-np.pi / 2, 25.0], [0.0, 95.0], [np.pi / 2, 75.0], [np.pi, 25.0]])
POINTS = np.array([[-25.0, -25.0], [95.0, -25.0]])


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return build_trajectory(drive(), NOISE, ConeSonar(), 0.15)


def perturbed(trajectory: Trajectory, seed: int, nodes: int = NODES) -> tuple[MapState, Assignment]:
    """Return a state of the first nodes off its optimum, and each echo at the feature that is nearest."""
    rng = np.random.default_rng(seed)
    poses = trajectory.odometry[:nodes] - trajectory.odometry[0]
    poses[:, :2] = rotate(poses[:, :2], np.full(nodes, -trajectory.odometry[0, 2]))
    parameters = 0.02 * rng.normal(size=20)
    state = MapState(poses, WALLS.copy(), POINTS.copy(), 0.0 * parameters)
    sensors = sensors_at(poses, state.parameters, trajectory, np.flatnonzero(trajectory.node < nodes))
    ranges = [predict_wall(sensors, np.broadcast_to(wall, (len(sensors.axis), 2))) for wall in WALLS]
    points = [predict_point(sensors, np.broadcast_to(point, (len(sensors.axis), 2))) for point in POINTS]
    far = [abs(p.range_in - sensors.range_in) + 99 * (abs(wrap_angle(p.bearing - sensors.axis)) > 0.3)
           for p in (*ranges, *points)]  # fmt: skip
    feature = np.full(len(trajectory.node), NO_FEATURE)
    feature[: len(sensors.axis)] = np.argmin(far, axis=0)
    ties = np.array([[0, 0], [0, 3], [1, 1]])
    state = MapState(
        poses + np.array((0.2, 0.2, 0.01)) * rng.normal(size=poses.shape) * (np.arange(nodes) > 0)[:, None],
        WALLS + np.array((0.01, 0.3)) * rng.normal(size=WALLS.shape),
        POINTS + 0.3 * rng.normal(size=POINTS.shape),
        parameters,
    )
    return state, Assignment(feature, ties)


def stepped(state: MapState, step: Floats) -> MapState:
    split = 3 * len(state.poses)
    return state.moved(step[:split].reshape(-1, 3), step[split:])


def dense(equations: NormalEquations) -> tuple[Floats, Floats]:
    """Return the matrix and the right-hand side, without the prior of the first pose."""
    count, size = len(equations.diagonal), equations.coupling.shape[-1]
    H = np.zeros((3 * count + size, 3 * count + size))
    for k in range(count):
        H[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = equations.diagonal[k]
    for k in range(count - 1):
        H[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] = equations.upper[k]
        H[3 * k + 3 : 3 * k + 6, 3 * k : 3 * k + 3] = equations.upper[k].T
    H[: 3 * count, 3 * count :] = equations.coupling.reshape(3 * count, size)
    H[3 * count :, : 3 * count] = H[: 3 * count, 3 * count :].T
    H[3 * count :, 3 * count :] = equations.border
    H[:3, :3] -= 1e8 * np.eye(3)
    return H, np.concatenate((equations.pose_gradient.reshape(-1), equations.border_gradient))


def difference_jacobian(problem: MapProblem, state: MapState, assignment: Assignment) -> Floats:
    """Return the derivative of all residuals by central differences."""
    size, h = 3 * len(state.poses) + state.walls.size + state.points.size + len(state.parameters), 1e-5
    size += len(state.levels)
    columns = []
    for k in range(size):
        step = np.zeros(size)
        step[k] = h
        ahead, behind = (problem.residual_vector(stepped(state, sign * step), assignment) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("rays", [False, True])
def test_normal_equations_are_those_of_difference_quotients(trajectory: Trajectory, rays: bool) -> None:
    problem = MapProblem(trajectory, 16, rays=rays, robust=False)
    state, assignment = perturbed(trajectory, 1)
    J, r = difference_jacobian(problem, state, assignment), problem.residual_vector(state, assignment)
    H, g = dense(problem.normal_equations(state, assignment))
    scale = np.sqrt(np.outer(np.diag(H), np.diag(H))) + 1.0
    np.testing.assert_allclose(H / scale, J.T @ J / scale, atol=1e-6)
    np.testing.assert_allclose(g / np.sqrt(np.diag(scale)), -J.T @ r / np.sqrt(np.diag(scale)), atol=1e-5)


def test_direction_of_a_point_within_the_cone_pulls_nothing(trajectory: Trajectory) -> None:
    # Exact readings of points from exact poses: no residual, wherever in the cone the points are.
    points = np.array([(x, y) for x in (-25.0, 30.0, 95.0) for y in (-25.0, 75.0)])
    state, _ = perturbed(trajectory, 1)
    state = replace(state, poses=trajectory.odometry[:NODES], points=points)
    poses = state.poses - np.array((*state.poses[0, :2], 0.0))
    state = replace(state, poses=poses, parameters=np.zeros_like(state.parameters))
    echoes = np.flatnonzero(trajectory.node < NODES)
    sensors = sensors_at(state.poses, state.parameters, trajectory, echoes)
    readings, feature = trajectory.readings_in.copy(), np.full(len(trajectory.node), NO_FEATURE)
    off_axis = []
    for number, point in enumerate(points):
        expected = predict_point(sensors, np.broadcast_to(point, (len(echoes), 2)))
        off = wrap_angle(expected.bearing - sensors.axis)
        within = np.abs(off) < np.radians(12.4)
        off_axis += np.abs(off[within]).tolist()
        readings[echoes[within]], feature[echoes[within]] = expected.range_in[within], len(WALLS) + number
    assert len(off_axis) > 5
    assert max(off_axis) > np.radians(6.0)
    problem = MapProblem(replace(trajectory, readings_in=readings), 16)
    linear = problem.linearize_echoes(state, Assignment(feature))
    np.testing.assert_allclose(linear.residuals, 0.0, atol=1e-9)
    np.testing.assert_array_equal(linear.by_pose[:, 1], 0.0)
    # In a map that stays as it is they bound the headings.
    fixed = MapProblem(problem.trajectory, 16, has_fixed_map=True).linearize_echoes(state, Assignment(feature))
    np.testing.assert_allclose(np.abs(fixed.residuals[:, 1]).max(), max(off_axis) / 0.2)
    # Outside of the cone they do in any.
    turned = replace(state, poses=state.poses + np.array((0.0, 0.0, np.radians(20.0))))
    assert np.abs(problem.linearize_echoes(turned, Assignment(feature)).by_pose[:, 1]).max() > 0.0


@pytest.mark.parametrize("std_rad", [RIGHT_ANGLE_STD_RAD, SQUARE_STD_RAD])
def test_robust_equations_are_half_the_cost_s_gradient(trajectory: Trajectory, std_rad: float) -> None:
    problem = MapProblem(trajectory, 16, right_angle_std_rad=std_rad)
    state, assignment = perturbed(trajectory, 2)
    _, g = dense(problem.normal_equations(state, assignment))
    h = 1e-5
    for k in (4, 7, 11, 36, 37, 44, 49, 50, 55):
        step = np.zeros(len(g))
        step[k] = h
        ahead, behind = (problem.cost(stepped(state, sign * step), assignment) for sign in (1.0, -1.0))
        assert g[k] == pytest.approx(-(ahead - behind) / (4.0 * h), rel=1e-4, abs=1e-3)


@given(st.floats(-6.0, 6.0))
def test_robust_weight_is_the_cost_s_slope(residual: float) -> None:
    r, h = np.array([residual]), 1e-6
    slope = (robust_cost(r + h) - robust_cost(r - h)) / (2.0 * h)
    np.testing.assert_allclose(slope, 2.0 * robust_weight(r) * r, atol=1e-6)


@pytest.mark.long
def test_optimum_is_that_of_scipy(trajectory: Trajectory) -> None:
    problem = MapProblem(trajectory, 16, robust=False)
    state, assignment = perturbed(trajectory, 3)
    found = problem.optimize(state, assignment, 30, 1e-10)
    size = 3 * len(state.poses) + state.walls.size + state.points.size + len(state.parameters)

    def residuals(free: Floats) -> Floats:
        return problem.residual_vector(stepped(state, np.concatenate((np.zeros(3), free))), assignment)

    reference = least_squares(residuals, np.zeros(size - 3), method="trf", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    best = stepped(state, np.concatenate((np.zeros(3), reference.x)))
    np.testing.assert_allclose(found.poses[:, :2], best.poses[:, :2], atol=2e-3)
    np.testing.assert_allclose(found.poses[:, 2], best.poses[:, 2], atol=2e-4)
    np.testing.assert_allclose(found.walls[:, 1], best.walls[:, 1], atol=2e-3)
    np.testing.assert_allclose(wrap_angle(found.walls[:, 0] - best.walls[:, 0]), 0.0, atol=2e-4)
    np.testing.assert_allclose(found.points, best.points, atol=2e-3)
    np.testing.assert_allclose(found.parameters, best.parameters, atol=2e-3)


@given(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0), st.floats(-3.1, 3.1), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_cost_is_the_same_in_every_frame(x: float, y: float, turn: float, seed: int) -> None:
    trajectory = build_trajectory(drive(), NOISE, ConeSonar(), 0.15)
    problem = MapProblem(trajectory, 16)
    state, assignment = perturbed(trajectory, seed)
    shift = np.array((x, y))
    poses = np.concatenate(
        (rotate(state.poses[:, :2], np.full(NODES, turn)) + shift, state.poses[:, 2:] + turn), axis=-1
    )
    angle = state.walls[:, 0] + turn
    walls = np.stack((angle, state.walls[:, 1] + x * np.cos(angle) + y * np.sin(angle)), axis=-1)
    moved = MapState(poses, walls, rotate(state.points, np.full(len(POINTS), turn)) + shift, state.parameters)
    assert problem.cost(moved, assignment) == pytest.approx(problem.cost(state, assignment), rel=1e-7)


def test_bearings_of_walls_and_points_have_densities_over_the_same_cone() -> None:
    """Oracle: integrals. A point's density is 1 by its width within the cone, a wall's a normal one that ends there."""

    def of_wall(bearing_rad: float) -> float:
        return float(np.exp(-0.5 * ((bearing_rad / WALL_BEARING_STD_RAD) ** 2 + BEARING_COST)))

    whole, _ = quad(of_wall, -HALF_CONE_RAD, HALF_CONE_RAD)
    assert whole == pytest.approx(2.0 * HALF_CONE_RAD, rel=1e-9)


@pytest.mark.parametrize(("rays", "reflection", "counts"), [
    (False, Reflection(surface_std_in=1.6), True), (False, Reflection(), False),
    (True, Reflection(surface_std_in=1.6), False),
])  # fmt: skip
def test_cost_is_that_of_all_residuals(
    trajectory: Trajectory, rays: bool, reflection: Reflection, counts: bool
) -> None:
    problem = MapProblem(trajectory, 16, rays=rays, robust=False, reflection=reflection)
    state, assignment = perturbed(trajectory, 3)
    feature = assignment.feature[trajectory.node < NODES]
    of_walls, unexplained = int(((feature >= 0) & (feature < len(WALLS))).sum()), int((feature == NO_FEATURE).sum())
    assert of_walls > 20
    residuals = np.square(problem.residual_vector(state, assignment)).sum()
    bearings = BEARING_COST * of_walls if counts else 0.0
    assert problem.cost(state, assignment) == pytest.approx(residuals + ROBUST_LIMIT**2 * unexplained + bearings)


# Surfaces of walls.

SURFACE = Reflection(0.4, 1.6, 24.0)


def with_levels(state: MapState, assignment: Assignment, seed: int) -> tuple[MapState, Assignment]:
    """Return the state with levels of two walls, one with a gap, and an arbitrary one of its wall for each echo."""
    rng = np.random.default_rng(seed)
    wall, cell = np.array([1, 1, 1, 3, 3, 3, 3]), np.array([-2, -1, 3, 0, 1, 2, 3])
    is_new = np.array([False, False, True, False, True, False, False])
    levels = Levels(wall, cell, 1.6 * rng.normal(size=len(wall)), np.zeros(len(wall)), is_new)
    level = np.full(len(assignment.feature), NO_LEVEL)
    for number in (1, 3):
        own = np.flatnonzero(assignment.feature == number)
        level[own] = rng.choice(np.flatnonzero(wall == number), len(own))
    return replace(state, levels=levels), replace(assignment, level=level)


@pytest.mark.parametrize("rays", [False, True])
def test_derivatives_by_levels_are_those_of_difference_quotients(trajectory: Trajectory, rays: bool) -> None:
    problem = MapProblem(trajectory, 16, rays=rays, robust=False, reflection=SURFACE)
    state, assignment = with_levels(*perturbed(trajectory, 5), 5)
    J, r = difference_jacobian(problem, state, assignment), problem.residual_vector(state, assignment)
    H, g = dense(problem.normal_equations(state, assignment))
    assert (np.abs(J[:, -7:]).sum(axis=0) > 0.0).all()
    scale = np.sqrt(np.outer(np.diag(H), np.diag(H))) + 1.0
    np.testing.assert_allclose(H / scale, J.T @ J / scale, atol=1e-6)
    np.testing.assert_allclose(g / np.sqrt(np.diag(scale)), -J.T @ r / np.sqrt(np.diag(scale)), atol=1e-5)
    # The optimum of all of them falls.
    assert problem.cost(problem.optimize(state, assignment, 5), assignment) < problem.cost(state, assignment)


def test_prior_of_levels_is_that_of_a_surface_that_stays_or_changes(trajectory: Trajectory) -> None:
    """Oracle: scipy's normal densities, and the probability that an exponentially distributed length ends."""
    problem = MapProblem(trajectory, 16, reflection=SURFACE)
    state, assignment = with_levels(*perturbed(trajectory, 6), 6)
    nothing = replace(assignment, level=np.full(len(assignment.level), NO_LEVEL))
    stay = np.exp(-LEVEL_CELL_IN / 24.0)

    def cost(levels: Levels) -> float:
        residuals, penalties = problem.level_residuals(levels)[0], problem.level_penalties(levels, nothing)
        return float(np.square(residuals).sum() + penalties.sum())

    b = state.levels.value_in
    is_same = [False, True, False, False, False, True, True]
    densities = [
        norm.logpdf(b[k], b[k - 1], SAME_LEVEL_STD_IN) - norm.logpdf(0.0, 0.0, SAME_LEVEL_STD_IN) if same
        else norm.logpdf(b[k], 0.0, 1.6) - norm.logpdf(0.0, 0.0, 1.6) for k, same in enumerate(is_same)
    ]  # fmt: skip
    # Four inches to the next cell, and sixteen to the one after a gap.
    choices = 3.0 * np.log(stay) + np.log(1.0 - stay) + np.log(1.0 - stay**4)
    assert cost(state.levels) == pytest.approx(-2.0 * (sum(densities) + choices))


@pytest.mark.parametrize("echoes", [1, 5, 40])
def test_penalty_of_a_level_is_what_its_probability_lacks(trajectory: Trajectory, echoes: int) -> None:
    problem = MapProblem(trajectory, 16, reflection=SURFACE)
    # n readings z = b + noise of variance R, b of variance v: z is normal with covariance R I + v 1 1'.
    level = np.full(len(trajectory.node), NO_LEVEL)
    level[:echoes] = 0
    R, z = np.square(trajectory.std_in[:echoes]), np.random.default_rng(echoes).normal(size=echoes)
    C = np.diag(R) + 1.6**2
    evidence = z @ np.linalg.solve(C, z) + np.linalg.slogdet(C)[1] - np.log(R).sum()
    # By the most likely level instead.
    b = (z / R).sum() / ((1.0 / R).sum() + 1.6**-2)
    levels = Levels(np.array([0]), np.array([3]), np.array([b]), np.zeros(1), np.array([False]))
    penalty = problem.level_penalties(levels, Assignment(np.zeros(len(level), dtype=np.intp), level=level))
    cost = (np.square(z - b) / R).sum() + np.square(problem.level_residuals(levels)[0]).sum()
    assert cost + penalty.sum() == pytest.approx(evidence)


def chain_of(trajectory: Trajectory) -> tuple[MapProblem, Levels, Assignment, Floats, Floats]:
    """Return levels of two walls, some without echoes, their prior covariance, and the information of their echoes."""
    problem = MapProblem(trajectory, 16, reflection=SURFACE)
    is_new = np.array([False, False, False, True, False, False])
    levels = Levels(np.array([0, 0, 0, 0, 0, 1]), np.array([0, 1, 2, 3, 4, 0]), np.zeros(6), np.zeros(6), is_new)
    level = np.full(len(trajectory.node), NO_LEVEL)
    level[:8] = 0, 0, 2, 2, 2, 4, 4, 4
    # Steps of a random walk from the levels that are drawn anew.
    begins = np.array([0, 0, 0, 3, 3, 5])
    steps = np.minimum(np.arange(6)[:, None], np.arange(6)) - begins
    C = np.where(begins[:, None] == begins, 1.6**2 + SAME_LEVEL_STD_IN**2 * steps, 0.0)
    information: Floats = np.zeros(6)
    np.add.at(information, level[:8], 1.0 / np.square(trajectory.std_in[:8]))
    return problem, levels, Assignment(np.zeros(len(level), dtype=np.intp), level=level), C, information


def test_penalty_of_a_chain_of_levels_is_that_of_all_of_its_cells(trajectory: Trajectory) -> None:
    """Oracle: the determinant of the covariance of all readings; a stretch that begins at a cell without echoes too."""
    problem, levels, assignment, C, information = chain_of(trajectory)
    stay = np.exp(-LEVEL_CELL_IN / 24.0)
    chosen = -2.0 * (3.0 * np.log(stay) + np.log(1.0 - stay))
    expected = np.linalg.slogdet(np.eye(6) + C * information)[1]
    assert problem.level_penalties(levels, assignment).sum() - chosen == pytest.approx(expected)


def test_variance_of_a_level_is_that_by_all_echoes_of_its_stretch(trajectory: Trajectory) -> None:
    """Oracle: the inverse of the information; the surface's own where no echo says that it has not changed."""
    problem, levels, assignment, C, information = chain_of(trajectory)
    smooth = np.diag(np.linalg.inv(np.linalg.inv(C) + np.diag(information)))
    once = 1.0 - np.exp(-LEVEL_CELL_IN / 24.0)
    changes = np.array((0.0, once**2, 0.0, once, 0.0, 1.0))
    expected = changes * 1.6**2 + (1.0 - changes) * smooth
    np.testing.assert_allclose(problem.level_variances(levels, assignment), expected)
    # Ranges that count for less say less.
    weight = np.full(len(assignment.level), 0.25)
    lighter = problem.with_trajectory(replace(trajectory, weight=weight))
    np.testing.assert_allclose(lighter.level_information(levels, assignment), 0.25 * information)


def test_nearest_level_is_that_of_the_nearest_cell_of_the_wall() -> None:
    levels = Levels(np.array([0, 0, 2, 2, 2]), np.array([-3, 4, -1, 0, 5]), np.arange(5.0), np.zeros(5),
                    np.zeros(5, dtype=np.bool_))  # fmt: skip
    rng = np.random.default_rng(7)
    walls, feet = rng.integers(0, 4, size=(50, 4)), rng.uniform(-40.0, 40.0, size=(50, 4))
    rows, away = levels.nearest(walls, feet)
    low = levels.cell * LEVEL_CELL_IN
    for wall, foot, row, distance in zip(walls.ravel(), feet.ravel(), rows.ravel(), away.ravel(), strict=True):
        beyond = np.maximum(np.maximum(low - foot, foot - low - LEVEL_CELL_IN), 0.0)
        beyond[levels.wall != wall] = np.inf
        if np.isinf(beyond).all():
            assert row == NO_LEVEL
            continue
        assert levels.wall[row] == wall
        assert distance == pytest.approx(beyond.min())
        assert beyond[row] == pytest.approx(beyond.min())
