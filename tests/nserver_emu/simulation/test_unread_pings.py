"""Pings that nothing read are simulated together, in a few array operations, and with the same results."""

from __future__ import annotations

import numpy as np
import pytest

from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.simulation import acoustics, infrared
from nserver_emu.simulation.acoustics import Ping, ReflectorMap
from nserver_emu.simulation.infrared import InfraredRing
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.noise import MEASURED
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise, SonarRing
from worlds import raycast
from worlds.geometry import NO_DISCS
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import Polygon

MODEL = MEASURED.sonar


def ring_history(seed: int, turned_rad: float) -> list[Ping]:
    """Return the pings of two rounds at rate 1, from a robot that drives."""
    rng = np.random.default_rng(seed)
    return [
        Ping(10.0 + 0.1 * number, 5.0, turned_rad + N150.sonar_angles_rad[sonar], (number + 1) * 4 * 10**9,
             MODEL.draw(rng))
        for number, sonar in enumerate(DEFAULT_ORDER * 2)
    ]  # fmt: skip


@pytest.mark.parametrize("world", ["several_walls", "centre_vertex"])
@pytest.mark.parametrize("robots", [0, 2])
def test_many_pings_equal_each_alone(world: str, robots: int) -> None:
    assert isinstance(MODEL, acoustics.Polaroid)
    reflectors = ReflectorMap(load_world(world).walls)
    discs = np.array([(40.0, 10.0, 9.0), (5.0, 45.0, 9.0)])[:robots] if robots else NO_DISCS
    for seed in range(3):
        history = ring_history(seed, 0.7 * seed)
        pings = history[16:]
        earlier = [history[number + 1 : number + 16] for number in range(16)]
        together = MODEL.measured_ranges(pings, earlier, reflectors, N150, [discs] * 16)
        alone = [
            MODEL.measured_ranges([ping], [before], reflectors, N150, [discs])[0]
            for ping, before in zip(pings, earlier, strict=True)
        ]
        np.testing.assert_allclose(together, alone, atol=1e-9)
        assert any(np.isfinite(together))


def test_a_poll_at_the_fastest_rate_takes_few_operations(monkeypatch: pytest.MonkeyPatch) -> None:
    """One by one, 16 pings with a dozen of earlier ones each took 200 times as many."""
    calls = 0
    cast_rays = raycast.cast_rays

    def counted(*args: object) -> object:
        nonlocal calls
        calls += 1
        return cast_rays(*args)  # type: ignore[arg-type]

    simulation = Simulation(load_world("several_walls"))
    robot = simulation.add_robot(1, setup=MEASURED)
    robot.configure_sonars(1, DEFAULT_ORDER)
    simulation.step(1.0)
    monkeypatch.setattr(acoustics, "cast_rays", counted)
    assert len(robot.sonar.readings_in) == 16
    assert 0 < calls <= 16
    calls = 0
    assert len(robot.sonar.readings_in) == 16
    assert calls == 0, "each ping is simulated once"


def test_new_obstacles_simulate_no_ping(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(load_world("several_walls"))
    robot = simulation.add_robot(1, model=N200)
    near = Polygon(((18.0, -4.0), (22.0, -4.0), (22.0, 4.0), (18.0, 4.0)))
    before = robot.sonar.readings_in
    simulation.step(0.98)
    with monkeypatch.context() as patched:
        patched.setattr(SonarRing, "_measured_ranges", None)
        patched.setattr(InfraredRing, "_ranges", None)
        patched.setattr(infrared, "cast_rays", None)
        for _ in range(100):
            simulation.change_world(simulation.world.with_obstacles((*simulation.world.obstacles, near)))
    # Pings of the time before still meet the walls of that time, whenever they are read.
    assert robot.sonar.readings_in == before
    simulation.step(1.0)
    assert robot.sonar.readings_in != before
    assert isinstance(robot.sonar.model, SonarNoise)


def test_part_of_the_pings_gives_the_same_readings() -> None:
    def ring() -> SonarRing:
        simulation = Simulation(load_world("several_walls"))
        robot = simulation.add_robot(1, setup=MEASURED)
        robot.configure_sonars(1, DEFAULT_ORDER)
        simulation.step(1.0)
        return robot.sonar

    at_once, in_parts, parts = ring(), ring(), 1
    while not in_parts.compute_some():
        parts += 1
    assert 2 <= parts <= 4
    assert in_parts.readings_in == at_once.readings_in
    assert in_parts.compute_some()


def test_exact_rays_are_not_divided() -> None:
    simulation = Simulation(load_world("several_walls"))
    assert simulation.add_robot(1).sonar.compute_some()
