"""The cone model: ranges by hand, derivatives by finite differences, probabilities against a count."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, cos, hypot, pi, radians, sin

import numpy as np
import pytest

from localization.filters.sonar_cone import ConeModel, ConeSonar, echo_probabilities, expected_echoes, reflectors
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.rings import SonarMount
from worlds.robots import N150

SURE = np.array(1e-9)
SQUARE_ROOM = [[-50, -50, 50, -50], [50, -50, 50, 50], [50, 50, -50, 50], [-50, 50, -50, -50]]
RIGHT_WALL = 1
MODEL = ConeSonar()
FRONT = SonarMount(0.0, 9.0)


def test_a_perpendicular_wall_is_detected_at_its_distance() -> None:
    found = expected_echoes(np.zeros(3), SURE, FRONT, reflectors(SQUARE_ROOM), MODEL)
    assert found.ranges_in[RIGHT_WALL] == pytest.approx(41.0)
    assert found.probability[RIGHT_WALL] == pytest.approx(1.0, abs=1e-6)
    assert found.probability.sum() == pytest.approx(1.0, abs=1e-6)


def test_a_slanted_wall_gives_its_perpendicular_distance() -> None:
    pose = np.array([0.0, 0.0, radians(10.0)])
    found = expected_echoes(pose, SURE, FRONT, reflectors(SQUARE_ROOM), MODEL)
    assert found.ranges_in[RIGHT_WALL] == pytest.approx(50.0 - 9.0 * cos(radians(10.0)))
    assert found.probability[RIGHT_WALL] > 0.99


def test_reflector_outside_cone_has_no_echo() -> None:
    pose = np.array([0.0, 0.0, radians(20.0)])
    found = expected_echoes(pose, SURE, FRONT, reflectors(SQUARE_ROOM), MODEL)
    assert not found.probability.any()


def test_right_angled_corner_is_measured_at_its_vertex() -> None:
    around = reflectors(SQUARE_ROOM)
    found = expected_echoes(np.array([0.0, 0.0, pi / 4]), SURE, FRONT, around, MODEL)
    detected = np.flatnonzero(found.probability > 0.5)
    assert len(detected) == 1
    assert tuple(around.vertices[detected[0] - len(around.walls)]) == (50.0, 50.0)
    assert found.ranges_in[detected[0]] == pytest.approx(hypot(50, 50) - 9.0)


def test_an_edge_is_too_faint_where_a_square_corner_is_not() -> None:
    wall_end = reflectors([[60, 0, 60, 50]])
    far = expected_echoes(np.array([-150.0, -20.0, atan2(20, 210)]), SURE, FRONT, wall_end, MODEL)
    assert far.probability.sum() < 0.02
    near = expected_echoes(np.array([0.0, -20.0, atan2(20, 60)]), SURE, FRONT, wall_end, MODEL)
    assert near.probability[1] > 0.99


def test_near_reflector_hides_far_reflector() -> None:
    found = expected_echoes(np.zeros(3), SURE, FRONT, reflectors([*SQUARE_ROOM, [30, -5, 30, 5]]), MODEL)
    assert found.probability[RIGHT_WALL] == 0.0
    assert found.probability[4] == pytest.approx(1.0, abs=1e-6)


def test_the_nearer_reflector_comes_first() -> None:
    beside = reflectors([*SQUARE_ROOM, [30, 1, 30, 40]])
    found = expected_echoes(np.zeros(3), SURE, FRONT, beside, MODEL)
    edge = len(beside.walls) + int(np.flatnonzero((beside.vertices == (30, 1)).all(axis=-1))[0])
    # A wall ends softly: it may be the wall itself.
    nearer = found.probability[edge] + found.probability[4]
    assert found.probability[edge] > 0.95
    assert nearer > 0.99
    assert found.probability[RIGHT_WALL] == pytest.approx(1.0 - nearer, abs=0.01)


@pytest.mark.parametrize("heading", [0.0, 0.1, pi / 4, 2.0, -2.4])
@pytest.mark.parametrize("direction", [0.0, 0.4, -2.9])
def test_the_derivative_against_finite_differences(heading: float, direction: float) -> None:
    around, tiny = reflectors([*SQUARE_ROOM, [10, 20, 30, 35]]), 1e-6
    pose, mount = np.array([3.0, -7.0, heading]), SonarMount(direction, 9.06)
    found = expected_echoes(pose, SURE, mount, around, MODEL)
    for axis, unit in enumerate(np.eye(3)):
        ahead = expected_echoes(pose + tiny * unit, SURE, mount, around, MODEL).ranges_in
        behind = expected_echoes(pose - tiny * unit, SURE, mount, around, MODEL).ranges_in
        np.testing.assert_allclose(found.H[:, axis], (ahead - behind) / (2 * tiny), atol=1e-6)


def test_an_uncertain_heading_makes_the_rim_of_the_cone_soft() -> None:
    """Against a count: how many of many headings have the wall's normal in the cone."""
    std, loud = radians(3.0), replace(MODEL, margin_db=90.0)
    for off_deg in (8.0, 12.5, 15.0):
        pose = np.array([0.0, 0.0, radians(off_deg)])
        detection = expected_echoes(pose, np.array(std), FRONT, reflectors(SQUARE_ROOM), loud).probability[RIGHT_WALL]
        headings = np.abs(radians(off_deg) + std * np.random.default_rng(3).normal(size=20_000))
        assert detection == pytest.approx((headings <= radians(12.5)).mean(), abs=0.03)


def test_many_poses_at_once_are_each_their_own() -> None:
    around = reflectors([*SQUARE_ROOM, [10, 20, 30, 35]])
    poses = np.random.default_rng(5).uniform([-30, -30, -pi], [5, 10, pi], size=(4, 6, 3))
    together = expected_echoes(poses, np.full((4, 6), 0.02), FRONT, around, MODEL)
    for at in np.ndindex(4, 6):
        alone = expected_echoes(poses[at], np.array(0.02), FRONT, around, MODEL)
        np.testing.assert_allclose(together.ranges_in[at], alone.ranges_in, atol=1e-12)
        np.testing.assert_allclose(together.probability[at], alone.probability, atol=1e-12)


def test_variance_has_relative_floor_rounding_and_place_parts() -> None:
    constant = 1 / 12 + MODEL.place_var_in2
    np.testing.assert_allclose(MODEL.variance(np.array([1.0, 100.0])), [0.05**2 + constant, 1.25**2 + constant])


def test_sonar_position_depends_on_heading() -> None:
    mount, pose = SonarMount(pi / 2, 9.0), np.array([10.0, 0.0, 0.0])
    found = expected_echoes(pose, SURE, mount, reflectors([[-50, 40, 50, 40]]), MODEL)
    assert found.ranges_in[0] == pytest.approx(40.0 - 9.0 * sin(pi / 2))


@pytest.mark.parametrize("spread", [(0.3, 0.3, 0.02), (6.0, 6.0, 0.3), (40.0, 40.0, 3.0)])
def test_omitted_reflectors_have_no_echo_in_any_particle(spread: tuple[float, float, float]) -> None:
    around, rng = reflectors(load_world("several_walls").walls), np.random.default_rng(9)
    # Nine directions around the robot; particles spread around the middle of the room.
    for direction in np.linspace(-3.0, 3.0, 9):
        mount = SonarMount(float(direction), 9.06)
        poses = np.array([45.0, 40.0, 0.7]) + spread * rng.uniform(-1.0, 1.0, size=(60, 3))
        every = expected_echoes(poses, np.full(60, 0.03), mount, around, MODEL)
        ranges, probabilities = echo_probabilities(poses, np.array(0.03), mount, around, MODEL)
        # Reflectors without an echo in any particle are left out; the others agree.
        detected = every.probability.any(axis=0)
        np.testing.assert_allclose(ranges, every.ranges_in[:, detected], atol=1e-12)
        np.testing.assert_allclose(probabilities, every.probability[:, detected], atol=1e-15)


@pytest.mark.parametrize(("range_in", "probability"), [(100.0, 1.0), (255.0, 0.5), (270.0, 0.0)])
def test_a_wall_beyond_the_limit_is_no_echo(range_in: float, probability: float) -> None:
    """Oracle: the wall, detected for certain, is nearer than the limit with this probability."""
    sonar = ConeSonar(margin_db=200.0)
    x_in = N150.sonar_ring_radius_in + range_in
    model = ConeModel([[x_in, -500.0, x_in, 500.0]], N150, sonar)
    x, P = [0.0, 0.0, 0.0], np.diag([1e-6, 1e-6, 1e-6]).tolist()
    found = model.associate(x, P, 0, 0.0, 255.0)
    assert found.likelihood == pytest.approx(1.0 - 0.9 * probability, abs=1e-3)
    short = model.associate(x, P, 0, 0.0, 90.0)
    assert sum(short.probability) == pytest.approx(probability, abs=1e-3)
    assert (short.refusal is Refusal.NO_WALL) == (probability == 0.0)
