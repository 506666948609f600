"""Room for many: as many as a world holds, none touching, and an end where there is no more."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from math import hypot

import numpy as np
import pytest
from scipy.spatial import cKDTree

from nserver_emu.server.config import MAX_RINGS, MAX_ROBOTS, SimulationConfig, StartPoseAllocator
from nserver_emu.simulation.axis import Command
from nserver_emu.simulation.models import N150, N200
from nserver_emu.simulation.simulation import Simulation
from worlds.io import world_names
from worlds.world import Polygon, StartPose, Walker, World

HALL = World(
    "hall", rooms=(Polygon(((-700.0, -20.0), (700.0, -20.0), (700.0, 600.0), (-700.0, 600.0))),),
    starts=(StartPose(0.0, 0.0, 1.0, 2.0), StartPose(300.0, 300.0)),
)


@pytest.mark.long
def test_the_most_robots_find_room_and_touch_nothing() -> None:
    simulation = Simulation(HALL)
    places = StartPoseAllocator(simulation)
    for number in range(1, MAX_ROBOTS + 1):
        place = places.next(N150.body.radius_in)
        assert place is not None
        simulation.add_robot(number, place, powered=False)
    centres = np.array([robot.disc[:2] for robot in simulation.robots.values()])
    assert len(cKDTree(centres).query_pairs(2.0 * N150.body.radius_in)) == 0
    assert min(HALL.clearance(x, y) for x, y in centres.tolist()) > N150.body.radius_in
    assert (simulation.robots[1].actual.steering_rad, simulation.robots[1].actual.turret_rad) == (1.0, 2.0)


@pytest.mark.long
def test_robots_start_beside_walkers() -> None:
    simulation = Simulation(replace(HALL, walkers=(Walker(((0.0, 25.0), (600.0, 25.0))),)))
    places = StartPoseAllocator(simulation)
    for number in range(1, 30):
        place = places.next(N150.body.radius_in)
        assert place is not None
        simulation.add_robot(number, place, powered=False)


def test_robots_of_two_sizes_share_the_starts_and_the_room_ends() -> None:
    corners = ((-40.0, -40.0), (40.0, -40.0), (40.0, 40.0), (-40.0, 40.0))
    simulation = Simulation(World("small", rooms=(Polygon(corners),)))
    places = StartPoseAllocator(simulation)
    number, models = 0, (N150, N200)
    while (place := places.next(models[number % 2].body.radius_in)) is not None:
        simulation.add_robot(number + 1, place, models[number % 2], powered=False)
        number += 1
    assert 4 <= number <= 12
    assert places.next(models[number % 2].body.radius_in) is None


def test_a_world_without_rooms_ends_with_the_last_ring() -> None:
    simulation = Simulation(World("plain"))
    tried = list(islice(StartPoseAllocator(simulation)._candidates(20.0), 100_000))
    assert len(tried) == 1 + 3 * MAX_RINGS * (MAX_RINGS + 1)


@pytest.mark.long
@pytest.mark.parametrize("world", world_names())
def test_two_robots_can_drive_ahead_in_shipped_worlds(world: str) -> None:
    (alone_in,) = distances_ahead_in(SimulationConfig(world=world).simulation())
    first_in, second_in = distances_ahead_in(SimulationConfig(world=world, others=(("n150", None),)).simulation())
    assert first_in == pytest.approx(alone_in, abs=0.01)  # the start of centre_vertex faces a wall, 21 in ahead
    assert second_in == pytest.approx(24.0, abs=0.1)


def distances_ahead_in(simulation: Simulation) -> list[float]:
    """Return how far each robot can drive ahead from its start, at most 24 in, while the others stand there."""
    found = []
    for robot in simulation.robots.values():
        x, y, _ = robot.disc
        robot.command_axis(0, Command.RELATIVE, 24.0)
        simulation.step(5.0)
        found.append(hypot(robot.disc[0] - x, robot.disc[1] - y))
        robot.command_axis(0, Command.RELATIVE, -found[-1])
        simulation.step(5.0)
    return found


def test_robots_without_room_ahead_come_last() -> None:
    corners = ((-80.0, -15.0), (60.0, -15.0), (60.0, 15.0), (-80.0, 15.0))
    simulation = Simulation(World("corridor", rooms=(Polygon(corners),)))
    places = StartPoseAllocator(simulation)
    found: list[StartPose] = []
    while (place := places.next(N150.body.radius_in)) is not None:
        simulation.add_robot(len(found) + 1, place, powered=False)
        found.append(place)
    assert [round(pose.x_in) for pose in found] == [0, -61, 20, -20, 41, -41]
