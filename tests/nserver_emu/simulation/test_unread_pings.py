"""Pings that nothing read are simulated when they are read, each once, and with the same results."""

from __future__ import annotations

import numpy as np
import pytest

from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.simulation import acoustics, sensors
from nserver_emu.simulation.acoustics import FIRST_ECHO, Ping, ReflectorMap
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.noise import IDEAL, MEASURED
from nserver_emu.simulation.sensors import InfraredRing
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise, SonarRing
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
def test_the_order_of_computing_changes_no_bit(world: str, robots: int) -> None:
    assert isinstance(MODEL, acoustics.Polaroid)
    reflectors = ReflectorMap(load_world(world).walls)
    discs = np.array([(40.0, 10.0, 9.0), (5.0, 45.0, 9.0)])[:robots] if robots else NO_DISCS
    for seed in range(3):
        history = ring_history(seed, 0.7 * seed)
        pings = history[16:]
        earlier = [history[number + 1 : number + 16] for number in range(16)]
        fired = list(zip(pings, earlier, strict=True))
        in_order = [MODEL.measured_range(*firing, reflectors, N150, discs) for firing in fired]
        alone = ReflectorMap(load_world(world).walls)
        backwards = [MODEL.measured_range(*firing, alone, N150, discs) for firing in reversed(fired)]
        assert in_order == backwards[::-1]
        assert any(np.isfinite(in_order))


@pytest.mark.long
def test_a_poll_at_the_fastest_rate_computes_each_ping_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0
    run = FIRST_ECHO.run

    def counted(*args: object) -> object:
        nonlocal calls
        calls += 1
        return run(*args)

    simulation = Simulation(load_world("several_walls"))
    robot = simulation.add_robot(1, setup=MEASURED)
    robot.configure_sonars(1, DEFAULT_ORDER)
    simulation.step(1.0)
    monkeypatch.setattr(FIRST_ECHO, "run", counted)
    assert len(robot.sonar.readings_in) == 16
    assert calls == 16
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
        patched.setattr(SonarRing, "_cast", None)
        patched.setattr(SonarRing, "_compute", None)
        patched.setattr(InfraredRing, "_ranges", None)
        patched.setattr(sensors, "cast_rays", None)
        for _ in range(100):
            simulation.change_world(simulation.world.with_obstacles((*simulation.world.obstacles, near)))
    # Pings of the time before still meet the walls of that time, whenever they are read.
    assert robot.sonar.readings_in == before
    simulation.step(1.0)
    assert robot.sonar.readings_in != before
    assert isinstance(robot.sonar.model, SonarNoise)


def full_ring() -> tuple[Simulation, SonarRing]:
    """Return a ring at its fastest rate that nothing has read for a second."""
    simulation = Simulation(load_world("several_walls"))
    robot = simulation.add_robot(1, setup=MEASURED)
    robot.configure_sonars(1, DEFAULT_ORDER)
    simulation.step(1.0)
    return simulation, robot.sonar


@pytest.mark.long
def test_steps_give_the_same_readings_as_all_at_once() -> None:
    (_, at_once), (_, in_steps) = full_ring(), full_ring()
    expected = at_once.readings_in
    steps = 1
    while not in_steps.compute_some():
        steps += 1
    assert steps == 16, "one ping in each"
    assert in_steps.readings_in == expected
    assert in_steps.compute_some()


@pytest.mark.long
@pytest.mark.parametrize("between", [1, 7, 16])
def test_pings_between_two_steps_change_no_reading(between: int) -> None:
    """A ping that another takes the place of before its range is known is forgotten, as when nothing was computed."""
    (one, at_once), (other, in_steps) = full_ring(), full_ring()
    for _ in range(5):
        for _ in range(3):
            in_steps.compute_some()
        one.step(0.004 * between)
        other.step(0.004 * between)
    assert in_steps.readings_in == at_once.readings_in
    assert in_steps.compute_some()


@pytest.mark.long
def test_a_begun_step_ends_with_the_old_model() -> None:
    (one, at_once), (other, in_steps) = full_ring(), full_ring()
    for _ in range(3):
        in_steps.compute_some()
    for simulation in (one, other):
        simulation.robots[1].set_noise_model(IDEAL)
    assert in_steps.readings_in == at_once.readings_in
    state = in_steps.to_state()
    in_steps.set_state(state, other.time_ps)
    assert in_steps.readings_in == at_once.readings_in


def test_exact_rays_are_not_divided() -> None:
    simulation = Simulation(load_world("several_walls"))
    assert simulation.add_robot(1).sonar.compute_some()
