"""The spatial hash against an exhaustive search, and in a simulation."""

from __future__ import annotations

from math import hypot

import numpy as np
import pytest

from nclient.errors import StartError
from nserver_emu.simulation.models import N150
from nserver_emu.simulation.multi_robot import SpatialHash
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose, World


def test_cells_find_what_an_exhaustive_search_finds() -> None:
    rng = np.random.default_rng(5)
    # 150 discs of 2 to 70 in: larger and smaller than a cell.
    discs = np.column_stack((rng.uniform(-300.0, 300.0, (150, 2)), rng.uniform(2.0, 70.0, 150))).tolist()
    spatial_hash = SpatialHash()
    for number, (x, y, radius) in enumerate(discs):
        spatial_hash.add(number, (x, y, radius))
    found = 0
    for x, y in rng.uniform(-400.0, 400.0, (80, 2)).tolist():
        # The exhaustive search: distance at most the sum of the radii.
        touched = [number for number, (u, v, radius) in enumerate(discs) if hypot(x - u, y - v) <= radius + 9.0]
        assert [number for number, _ in spatial_hash.touched(x, y, 9.0)] == touched
        found += len(touched)
    assert found > 100
    assert SpatialHash().touched(0.0, 0.0, 9.0) == []


def test_moved_robots_block_their_new_positions() -> None:
    # 40 in ahead after 2 s.
    simulation = Simulation(World("plain"))
    simulation.add_robot(7, StartPose(0.0, 0.0)).set_velocities(20.0, 0.0, 0.0)
    simulation.step(2.0)
    # The old place is free for another robot.
    simulation.add_robot(3, StartPose(0.0, 0.0))
    assert list(simulation.robots) == [3, 7]
    with pytest.raises(StartError, match=r"robot 7.*\(40\.0, 0\.0\) in; 19"):
        simulation.require_free(40.0, 0.0, N150.body.radius_in)
    # The robot itself does not block its own place.
    simulation.require_free(40.0, 0.0, N150.body.radius_in, 7)
    # Placing moves it in the index as well.
    simulation.place(7, 100.0, 0.0, 0.0, 0.0)
    simulation.require_free(40.0, 0.0, N150.body.radius_in)
    with pytest.raises(StartError, match="touches robot 7"):
        simulation.require_free(100.0, 0.0, N150.body.radius_in)


def test_robots_without_power_still_collide() -> None:
    simulation = Simulation(World("plain"))
    for number, x in enumerate((0.0, 30.0)):
        simulation.add_robot(number + 1, StartPose(x, 0.0), powered=False).set_velocities(20.0, 0.0, 0.0)
    simulation.robots[2].stop()
    simulation.step(2.0)
    first, second = simulation.robots.values()
    assert second.actual.x_in - first.actual.x_in == pytest.approx(2.0 * N150.body.radius_in)
