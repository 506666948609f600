"""Tenths by axis: what a Scout's commands and State count in, against an N150's."""

from __future__ import annotations

from math import radians

import pytest

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import axis_tenths, axis_values
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import meet
from worlds.io import load_world
from worlds.world import StartPose


def emulator(model: str) -> Emulator:
    simulation = Simulation(load_world("thesis_room"))
    simulation.add_robot(1, StartPose(40.0, 40.0), MODELS[model])
    return Emulator(simulation)


@pytest.mark.parametrize(
    ("model", "values"),
    [("n150", (10.0, radians(20.0), radians(-30.0))), ("scout", (10.0, 20.0, radians(-30.0)))],
)
def test_there_and_back(model: str, values: tuple[float, float, float]) -> None:
    robot = emulator(model).simulation.robots[1]
    assert axis_values(robot, (100, 200, -300)) == pytest.approx(values)
    assert axis_tenths(robot, values) == (100, 200, -300)
    assert axis_tenths(robot, (0.01, -1e-5, 0.0)) == (1, -1, 0)


def test_a_scout_on_the_wire() -> None:
    server = emulator("scout")
    client, _ = meet(server)
    slots = client.ask("vm", 120, -80, 50).slots
    assert (slots[38], slots[39], slots[40], slots[41]) == (120, -80, 0, 0b011)
    server.simulation.step(0.5)
    slots = client.ask("gs").slots
    assert slots[36] == slots[37] == round((12.0 + 8.0) * 0.5 / (2 * 0.118597) * 10)
    assert client.ask("st").slots[41] == 0
