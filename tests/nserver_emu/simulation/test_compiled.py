"""A simulation with machine code and one without: the same to the bit."""

from __future__ import annotations

import pytest

from nserver_emu.simulation import sonar
from nserver_emu.simulation.noise import IDEAL, NOISY, RobotSetup
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.visibility import NEAREST_OBSTACLE, nearest_obstacle
from worlds.compiled import CompiledFunction
from worlds.world import Polygon, StartPose, World


@pytest.mark.long
@pytest.mark.parametrize("setup", [IDEAL, NOISY], ids=lambda setup: setup.name)
def test_compiled_code_changes_no_bit_of_a_simulation(setup: RobotSetup, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    loaded, plain = (
        CompiledFunction(nearest_obstacle, NEAREST_OBSTACLE._sources, NEAREST_OBSTACLE._example) for _ in range(2)
    )
    assert loaded.load()

    def lived(kernel: CompiledFunction) -> list[object]:
        monkeypatch.setattr(sonar, "NEAREST_OBSTACLE", kernel)
        # A small square room, so that echoes and contacts occur.
        square = Polygon(((-70.0, -70.0), (70.0, -70.0), (70.0, 70.0), (-70.0, 70.0)))
        simulation = Simulation(World("square", rooms=(square,)), seed=9)
        for number in range(3):
            simulation.add_robot(number + 1, StartPose(-40.0 + 40.0 * number, 3.0 * number, number, 0.0), setup=setup)
        rows: list[object] = []
        for step in range(60):
            for number, robot in simulation.robots.items():
                # New velocities every 1.8 s.
                if step % 12 == 0:
                    robot.set_velocities(14.0, 0.4 * (number - 2), 0.3)
                rows.append((robot.actual, robot.encoder, robot.sonar.readings_in, robot.sonar.stamps))
            simulation.step(0.15)
            # A snapshot in the middle: restored state uses the same code.
            if step == 30:
                simulation = Simulation.from_state(simulation.to_state())
        return rows

    assert lived(loaded) == lived(plain)
