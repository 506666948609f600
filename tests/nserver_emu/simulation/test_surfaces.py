"""The surfaces of walls: their statistics, and what a sonar measures of them."""

from dataclasses import replace
from math import exp, radians, sqrt

import numpy as np
import pytest

from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap, Surfaces
from nserver_emu.simulation.noise import BUILDING, MEASURED
from nserver_emu.simulation.simulation import Simulation
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import StartPose

LONG_IN = 200_000.0
WALL = np.array([0.0, 0.0, LONG_IN, 0.0])
STD_IN, LENGTH_IN, SPACING_IN = 1.5, 20.0, 40.0
assert isinstance(BUILDING.sonar, Polaroid)
QUIET = replace(BUILDING.sonar, range_std_relative=0.0, range_std_floor_in=0.0)
SURFACE = Surfaces(7, STD_IN, LENGTH_IN, SPACING_IN).of(WALL)


def ranges_in(model: Polaroid, wall: np.ndarray, pings: list[Ping], seed: int = 3) -> np.ndarray:
    reflectors = ReflectorMap(np.atleast_2d(wall), model.surfaces(seed))
    return np.array([model.measured_range(ping, (), reflectors, N150) for ping in pings])


def test_levels_are_normal_with_the_stated_deviation() -> None:
    levels = SURFACE.levels_in
    assert abs(levels.mean()) < 4.0 * STD_IN / sqrt(len(levels))
    assert levels.std() == pytest.approx(STD_IN, rel=4.0 / sqrt(2 * len(levels)))


@pytest.mark.parametrize("apart_in", [2.0, 5.0, 20.0, 40.0])
def test_the_correlation_is_exponential(apart_in: float) -> None:
    """Oracle: the correlation of a level redrawn at the points of a Poisson process, exp(-distance / length)."""
    along = np.arange(0.0, LONG_IN - apart_in, 1.0)
    one, other = SURFACE.level_in(along), SURFACE.level_in(along + apart_in)
    assert (one * other).mean() / (one * one).mean() == pytest.approx(exp(-apart_in / LENGTH_IN), abs=0.04)


def test_posts_are_a_poisson_process() -> None:
    gaps = np.diff(SURFACE.posts_in)
    assert gaps.mean() == pytest.approx(SPACING_IN, rel=0.06)
    assert gaps.std() == pytest.approx(gaps.mean(), rel=0.06), "of an exponential distribution both are equal"


def test_a_surface_depends_on_seed_and_wall_alone() -> None:
    surfaces, again = Surfaces(7, STD_IN, LENGTH_IN, SPACING_IN), Surfaces(7, STD_IN, LENGTH_IN, SPACING_IN)
    other_first = np.array([0.0, 50.0, 300.0, 50.0])
    again.of(other_first)
    for part, same in zip(surfaces.of(WALL), again.of(WALL), strict=True):
        np.testing.assert_array_equal(part, same)
    assert not np.array_equal(surfaces.of(other_first).levels_in[:1], surfaces.of(WALL).levels_in[:1])
    other_seed = Surfaces(8, STD_IN, LENGTH_IN, SPACING_IN).of(WALL)
    assert not np.array_equal(other_seed.levels_in[:5], SURFACE.levels_in[:5])


def test_surfaces_of_walls_that_stay_are_drawn_once() -> None:
    """Drawing costs more than all else where a thousand obstacles stand; walls that are gone take no memory."""
    surfaces, other = Surfaces(7, STD_IN, LENGTH_IN, SPACING_IN), np.array([0.0, 50.0, 300.0, 50.0])
    drawn, gone = surfaces.of_all(np.array([WALL, other]))
    (same_wall,) = surfaces.of_all(WALL[None])
    assert same_wall is drawn
    _, again = surfaces.of_all(np.array([WALL, other]))
    assert again is not gone
    for part, same in zip(again, gone, strict=True):
        np.testing.assert_array_equal(part, same)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_perpendicular_echo_is_shorter_by_the_level(side: float) -> None:
    """Oracle: distance to the wall less the level there, seen from either side of it."""
    wall = np.array([0.0, 0.0, 300.0, 0.0])
    model = replace(QUIET, post_spacing_in=0.0)
    x_in = np.linspace(60.0, 240.0, 30)
    pings = [Ping(x, side * 40.0, radians(-90.0 * side), 0, (0.0, 0.0)) for x in x_in.tolist()]
    surfaces = model.surfaces(3)
    assert surfaces is not None
    expected = 40.0 - N150.sonar_ring_radius_in - side * surfaces.of(wall).level_in(x_in)
    np.testing.assert_allclose(ranges_in(model, wall, pings), expected, atol=1e-6)


def test_a_post_is_detected_where_a_wall_alone_is_not() -> None:
    """From 45 degrees a plane returns nothing; a post in the cone does, at its distance."""
    wall = np.array([0.0, 0.0, 300.0, 0.0])
    model = replace(QUIET, surface_std_in=0.0)
    surfaces = model.surfaces(3)
    assert surfaces is not None
    posts_in = surfaces.of(wall).posts_in
    post = posts_in[np.searchsorted(posts_in, 100.0)]
    ping = Ping(float(post) - 40.0, 40.0, radians(-45.0), 0, (0.0, 0.0))
    found = ranges_in(model, wall, [ping])[0]
    face = complex(ping.x_in, ping.y_in) + (N150.sonar_ring_radius_in - model.recess_in) * np.exp(-0.25j * np.pi)
    distances = np.abs(posts_in - face)
    assert np.abs(distances - model.recess_in - found).min() < 1e-6
    assert np.isinf(ranges_in(replace(model, post_spacing_in=0.0), wall, [ping])[0])


def test_robots_of_a_run_meet_the_same_surface() -> None:
    def readings(seed: int) -> list[tuple[float, ...]]:
        simulation = Simulation(load_world("thesis_room"), seed=seed)
        starts = [StartPose(20.0, 20.0, 0.0, 0.0), StartPose(70.0, 70.0, 0.0, 0.0)]
        robots = [simulation.add_robot(number, start, setup=BUILDING) for number, start in enumerate(starts, 1)]
        surfaces = [robot.sonar.model.surfaces(robot.rng_factory.seed) for robot in robots]
        assert surfaces[0] == surfaces[1]
        return [robot.sonar.readings_in for robot in robots]

    assert readings(1) == readings(1)
    assert readings(1) != readings(2)


def test_measured_walls_are_planes() -> None:
    assert MEASURED.sonar.surfaces(0) is None
