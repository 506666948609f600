"""Fixtures of the physics tests: a closed square room and robots in it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from nserver_emu.simulation.noise import IDEAL, RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from worlds.world import Polygon, StartPose, World


@pytest.fixture
def room() -> World:
    """Return a room from -100 to 100 in in both directions, with nothing inside."""
    return World("room", rooms=(Polygon(((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))),))


@pytest.fixture
def lone(room: World) -> Callable[..., tuple[Simulation, SimulatedRobot]]:
    """A simulation of that room and its only robot."""

    def build(
        start: StartPose | None = None, setup: RobotSetup = IDEAL, seed: int = 1
    ) -> tuple[Simulation, SimulatedRobot]:
        simulation = Simulation(room, seed)
        return simulation, simulation.add_robot(1, start, setup=setup)

    return build
