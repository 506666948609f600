"""Room for many: as many as a world holds, none touching, and an end where there is no more."""

from __future__ import annotations

from itertools import islice

import numpy as np
from scipy.spatial import cKDTree

from nserver_emu.server.config import MAX_RINGS, MAX_ROBOTS, StartPoseAllocator
from nserver_emu.simulation.models import N150, N200
from nserver_emu.simulation.simulation import Simulation
from worlds.world import Polygon, StartPose, World

HALL = World(
    "hall", rooms=(Polygon(((-700.0, -20.0), (700.0, -20.0), (700.0, 600.0), (-700.0, 600.0))),),
    starts=(StartPose(0.0, 0.0, 1.0, 2.0), StartPose(300.0, 300.0)),
)


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
