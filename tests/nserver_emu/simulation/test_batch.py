"""The batch simulation against single simulations of the same seed: the same source in plain Python, and compiled."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from nclient.errors import ExtraMissing, StartError
from nserver_emu import simulation as package
from nserver_emu.simulation.batch import MAX_TIME_S, BatchSimulation
from nserver_emu.simulation.models import N150, N200, SCOUT, RobotModel, parse_models
from nserver_emu.simulation.noise import IDEAL, MEASURED, NOISY, WORN, RobotSetup, parse_setup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from worlds.io import load_world
from worlds.raycast import nearest_wall
from worlds.world import Polygon, StartPose, World

batch_kernel = pytest.importorskip("nserver_emu.simulation.batch_kernel", exc_type=ImportError)

ROOM = load_world("thesis_room")
DT_S = 0.13
PAGE = Path(__file__).parents[3] / "docs" / "batch.md"


def singles(count: int, model: RobotModel, setup: RobotSetup, seed: int = 7) -> list[Simulation]:
    found = []
    for number in range(1, count + 1):
        simulation = Simulation(ROOM, seed)
        simulation.add_robot(number, model=model, setup=setup)
        found.append(simulation)
    return found


def robots_of(simulations: Sequence[Simulation]) -> list[SimulatedRobot]:
    return [robot for simulation in simulations for robot in simulation.robots.values()]


def differences(batch: BatchSimulation, simulations: Sequence[Simulation]) -> list[float]:
    """Return the largest differences of poses, encoders, ranges, bumpers and motion flags."""
    robots = robots_of(simulations)
    pairs: list[tuple[Any, Any]] = [
        ([robot.actual for robot in robots], batch.actual),
        ([robot.encoder for robot in robots], batch.encoder),
        ([robot.sonar.readings_in for robot in robots], batch.ranges_in),
        ([robot.bumpers for robot in robots], batch.bumpers),
        ([robot.moving for robot in robots], batch.moving),
    ]
    return [float(np.abs(np.array(single, dtype=float) - np.array(many, dtype=float)).max()) for single, many in pairs]


def drive(
    batch: BatchSimulation, simulations: Sequence[Simulation], steps: int, rng: np.random.Generator
) -> list[list[float]]:
    """Drive both at random, velocities and distances by turns, and return their differences after each step."""
    limits = (25.0, 25.0, 1.0) if batch.model is SCOUT else (25.0, 0.8, 0.8)
    found = []
    for step in range(steps):
        if step % 15 == 0:
            values = rng.uniform(-1.0, 1.0, (len(batch), 3)) * limits
            is_relative = step % 45 == 30
            (batch.move_relative if is_relative else batch.set_velocities)(*values.T)
            for robot, row in zip(robots_of(simulations), values.tolist(), strict=True):
                (robot.move_relative if is_relative else robot.set_velocities)(*row)
        batch.step(DT_S)
        for simulation in simulations:
            simulation.step(DT_S)
        found.append(differences(batch, simulations))
    return found


@pytest.mark.usefixtures("plain_batch")
@pytest.mark.parametrize("model", [N150, SCOUT], ids=lambda model: model.name)
@pytest.mark.parametrize("setup", [IDEAL, NOISY, WORN], ids=lambda setup: setup.name)
def test_batch_equals_single_robots(model: RobotModel, setup: RobotSetup) -> None:
    batch, simulations = BatchSimulation(ROOM, 2, model=model, setup=setup, seed=7), singles(2, model, setup)
    assert differences(batch, simulations) == [0.0] * 5
    batch.set_timeout(1.2)
    for robot in robots_of(simulations):
        robot.set_timeout(1.2)
    found = drive(batch, simulations, 46, np.random.default_rng(2))
    assert np.max(found) <= (0.0 if setup is IDEAL else 1e-9)


@pytest.mark.long
@pytest.mark.parametrize("model", [N150, SCOUT], ids=lambda model: model.name)
@pytest.mark.parametrize("setup", [IDEAL, NOISY, WORN], ids=lambda setup: setup.name)
def test_compiled_batch_equals_single_robots(model: RobotModel, setup: RobotSetup) -> None:
    batch, simulations = BatchSimulation(ROOM, 5, model=model, setup=setup, seed=7, threads=2), singles(5, model, setup)
    found = drive(batch, simulations, 90, np.random.default_rng(4))
    # At last into a wall.
    velocities = (20.0, 20.0 if model is SCOUT else 0.0, 0.0)
    batch.set_velocities(*velocities)
    batch.step(20.0)
    for robot, simulation in zip(robots_of(simulations), simulations, strict=True):
        robot.set_velocities(*velocities)
        simulation.step(20.0)
    assert batch.bumpers.any()
    assert max(*differences(batch, simulations), np.max(found)) <= (0.0 if setup is IDEAL else 1e-9)


@pytest.mark.usefixtures("plain_batch")
def test_drives_of_the_test_touch_walls_and_slip() -> None:
    batch = BatchSimulation(ROOM, 1, setup=WORN, seed=7, threads=1)
    batch.set_velocities(20.0, 0.0, 0.0)
    batch.step(20.0)
    assert batch.bumpers[0]
    assert not batch.moving.any()
    # The wheels roll 0.1 in at the contact, and noise separates the encoders from the true pose.
    assert np.abs(batch.encoder - batch.actual)[0, :2].max() > 0.01


@pytest.mark.usefixtures("plain_batch")
def test_unusual_rings_and_dead_sonars_equal_a_single_robot() -> None:
    text = """
[[model]]
name = "other"
like = "n150"
[model.ring]
angles_deg = [0, 90, 200]
mounts_in = [[8, 1], [0, 9], [-7, -3]]
order = [[0, 2], 1]
interval_s = 0.048
resolution_in = 0.25
"""
    model = parse_models(text, "models.toml")["other"]
    sonars = 'base = "noisy"\n[sonar]\ndead = [1]\nturned_deg = 2\noffsets_in = [1.5, 0, -2]\n'
    setup = parse_setup(sonars, "s.toml", "s")
    batch, simulations = BatchSimulation(ROOM, 1, model=model, setup=setup, seed=7), singles(1, model, setup)
    assert np.max(drive(batch, simulations, 20, np.random.default_rng(1))) <= 1e-9
    assert batch.ranges_in[0, 1] == 0.0


@pytest.mark.usefixtures("plain_batch")
def test_sonar_orders_equal_those_of_a_single_robot() -> None:
    batch, simulations = BatchSimulation(ROOM, 1, seed=7), singles(1, N150, IDEAL)
    for rate, order in ((1, [3, 5, 99, 0]), (400, [2]), (5, [])):
        batch.configure_sonars(rate, order)
        robots_of(simulations)[0].configure_sonars(rate, order)
        assert np.max(drive(batch, simulations, 6, np.random.default_rng(1))) == 0.0


@pytest.mark.usefixtures("plain_batch")
def test_pings_repeated_within_a_step_leave_their_noise() -> None:
    batch, simulations = BatchSimulation(ROOM, 1, setup=NOISY, seed=7), singles(1, N150, NOISY)
    batch.configure_sonars(1, [3, 5, 8])
    robots_of(simulations)[0].configure_sonars(1, [3, 5, 8])
    assert np.max(drive(batch, simulations, 6, np.random.default_rng(8))) <= 1e-9
    # 33 firings in 0.13 s.
    assert batch._robots["fired"][0] > 6 * 32


@pytest.mark.usefixtures("plain_batch")
def test_ranges_are_those_of_the_nearest_wall() -> None:
    rng = np.random.default_rng(3)
    walls = np.concatenate((rng.uniform(-50.0, 50.0, (20, 4)), [[-60.0, 10.0, 60.0, 10.0], [10.0, 10.0, 10.0, 60.0]]))
    columns, ranges = tuple(walls.T.copy()), np.empty(len(walls))
    for x, y, angle in rng.uniform((-50.0, -50.0, 0.0), (50.0, 50.0, 2.0 * pi), (200, 3)).tolist():
        ray = (x, y, np.cos(angle), np.sin(angle))
        found = batch_kernel._range_from_axis(*ray, columns, 0, len(walls), ranges)
        assert found == nearest_wall(*ray, walls.tolist())[0]
    # Along a wall, and through the end of one.
    for ray in ((0.0, 10.0, 1.0, 0.0), (10.0, 0.0, 0.0, 1.0)):
        assert batch_kernel._range_from_axis(*ray, columns, 0, len(walls), ranges) == batch_kernel.UNDECIDED


@pytest.mark.usefixtures("plain_batch")
def test_rays_through_corners_equal_those_of_a_single_robot() -> None:
    corners = ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))
    world = World("square", rooms=(Polygon(corners),), inner_walls=np.array([[30.0, 0.0, 60.0, 0.0]]))
    start = StartPose(0.0, 0.0, 0.0, 0.0)
    simulation = Simulation(world, 1)
    robot = simulation.add_robot(1, start)
    batch = BatchSimulation(world, 1, starts=(0.0, 0.0, 0.0, 0.0), seed=1)
    assert batch.ranges_in[0].tolist() == list(robot.sonar.readings_in)


@pytest.mark.usefixtures("plain_batch")
def test_timeouts_equal_those_of_a_single_robot() -> None:
    batch, simulations = BatchSimulation(ROOM, 1, setup=NOISY, seed=7), singles(1, N150, NOISY)
    for seconds in (2.0, 0.5, 0.0, 0.3):
        batch.set_velocities(5.0, 0.0, 0.0)
        robots_of(simulations)[0].set_velocities(5.0, 0.0, 0.0)
        for half in (seconds, 0.5 * seconds):
            batch.set_timeout(half)
            robots_of(simulations)[0].set_timeout(half)
            for _ in range(4):
                batch.step(0.2)
                simulations[0].step(0.2)
            assert np.max(differences(batch, simulations)) <= 1e-9
        # Without a time-out the robot drives on.
        assert batch.timed_out[0] == (seconds > 0.0)


@pytest.mark.usefixtures("plain_batch")
def test_each_robot_may_have_its_own_world() -> None:
    square = World("square", rooms=(Polygon(((-60.0, -60.0), (60.0, -60.0), (60.0, 60.0), (-60.0, 60.0))),))
    batch = BatchSimulation([square, ROOM, square])
    single = Simulation(square)
    robot = single.add_robot(1, StartPose(*batch.actual[0].tolist()))
    assert batch.ranges_in[0].tolist() == list(robot.sonar.readings_in) == batch.ranges_in[2].tolist()
    assert batch.ranges_in[1].tolist() != batch.ranges_in[0].tolist()


@pytest.mark.usefixtures("plain_batch")
def test_reset_begins_anew_with_some_robots() -> None:
    batch = BatchSimulation(ROOM, 2, setup=NOISY, seed=7)
    start, first = batch.actual, batch.ranges_in
    batch.set_velocities(8.0, 0.1, 0.0)
    batch.step(1.0)
    before = batch.actual
    batch.reset(np.array([True, False]), seed=7)
    assert batch.actual.tolist() == [start[0].tolist(), before[1].tolist()]
    assert batch.time_s.tolist() == [0.0, 1.0]
    assert batch.ranges_in[0].tolist() == first[0].tolist()
    assert batch.moving.tolist() == [[False] * 3, [True, True, False]]
    simulations = singles(1, N150, NOISY)
    batch.set_velocities(8.0, 0.1, 0.0, [True, False])
    robots_of(simulations)[0].set_velocities(8.0, 0.1, 0.0)
    batch.step(1.0)
    simulations[0].step(1.0)
    assert np.abs(batch.actual[0] - robots_of(simulations)[0].actual).max() <= 1e-9


@pytest.mark.usefixtures("plain_batch")
def test_reset_without_seed_draws_other_noise() -> None:
    batch = BatchSimulation(ROOM, 1, setup=NOISY, seed=7)
    runs = []
    for _ in range(2):
        batch.set_velocities(8.0, 0.1, 0.0)
        batch.step(1.0)
        runs.append(batch.actual[0].tolist())
        batch.reset()
    assert runs[0] != runs[1]


@pytest.mark.usefixtures("plain_batch")
def test_reset_takes_new_starts() -> None:
    batch = BatchSimulation(ROOM, 2, model=SCOUT)
    x, y = ROOM.starts[0].x_in, ROOM.starts[0].y_in
    batch.reset([False, True], starts=(x + 1.0, y, 0.5, 2.0))
    # Steering and turret of a Scout are one angle.
    assert batch.actual[1].tolist() == pytest.approx([x + 1.0, y, 0.5, 0.5])
    with pytest.raises(StartError, match="robot 1 of the batch"):
        batch.reset(starts=np.array([[x, y, 0.0, 0.0], [1e4, 0.0, 0.0, 0.0]]))


@pytest.mark.usefixtures("plain_batch")
@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_no_bit(threads: int) -> None:
    batch, simulations = BatchSimulation(ROOM, 4, seed=7, threads=threads), singles(4, N150, IDEAL)
    assert np.max(drive(batch, simulations, 8, np.random.default_rng(4))) == 0.0


@pytest.mark.usefixtures("plain_batch")
def test_stop_brakes() -> None:
    batch = BatchSimulation(ROOM, 1, threads=1)
    batch.set_velocities(5.0, 0.0, 0.0)
    batch.stop()
    assert not batch.moving.any()


@pytest.mark.usefixtures("plain_batch")
def test_memory_of_a_robot() -> None:
    assert BatchSimulation([ROOM] * 2).bytes_per_robot < 4096


@pytest.mark.usefixtures("plain_batch")
@pytest.mark.parametrize(("arguments", "word"), [
    ({"model": N200}, "infrared"), ({"setup": MEASURED}, "Polaroid"), ({"robots": 0}, "1 or more"),
    ({"robots": None}, "1 or more"), ({"worlds": []}, "one world"), ({"worlds": [ROOM], "robots": 2}, "one world"),
])  # fmt: skip
def test_what_a_batch_cannot_simulate_is_refused(arguments: dict[str, Any], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        BatchSimulation(**{"worlds": ROOM, "robots": 2, **arguments})


@pytest.mark.usefixtures("plain_batch")
def test_bad_commands_and_steps_are_refused() -> None:
    batch = BatchSimulation(ROOM, 2, threads=1)
    with pytest.raises(ValueError, match="finite"):
        batch.set_velocities(float("nan"), 0.0, 0.0)
    with pytest.raises(ValueError, match="mask"):
        batch.stop([True])
    with pytest.raises(ValueError, match="several steps"):
        batch.step(3601.0)
    batch._robots["time_ps"] = int(MAX_TIME_S) * 10**12
    with pytest.raises(ValueError, match="reset"):
        batch.step(1.0)


def test_missing_numba_is_named_with_the_install_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nserver_emu.simulation.batch_kernel", None)
    monkeypatch.delattr(package, "batch_kernel")
    with pytest.raises(ExtraMissing, match=r"pip install -e '\.\[fast\]'"):
        BatchSimulation(ROOM, 1)


@pytest.mark.usefixtures("plain_batch")
def test_example_of_the_page_runs() -> None:
    code = PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    exec(code.replace("10_000", "3").replace("600", "3"), {})


def test_loops_compile_without_a_cache_directory(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def njit(**options: object) -> Any:
        if "cache" in options:
            raise RuntimeError("cannot cache function")
        return with_statistics

    def with_statistics(loop: Any) -> Any:
        loop.stats = SimpleNamespace(cache_path=None)
        return loop

    monkeypatch.setattr("numba.njit", njit)
    assert batch_kernel.load_loops.__wrapped__().advance.__name__ == "advance"
    assert "compiling the batch simulation" in caplog.text


def test_remainder_for_numba_is_that_of_the_library() -> None:
    from math import remainder, tau

    form = batch_kernel._remainder_form(None, None)
    values = [*np.random.default_rng(1).uniform(-40.0, 40.0, 200).tolist(), 0.0, pi, -pi, 3 * pi, tau, 2.5 * tau]
    assert [form(value, tau) for value in values] == [remainder(value, tau) for value in values]


def test_methods_are_given_to_their_class_only() -> None:
    class Kind:
        instance_class = batch_kernel.Capsule

    method = batch_kernel.Capsule.gap_to
    assert batch_kernel._of_class(batch_kernel.Capsule, method)(Kind()) is method
    assert batch_kernel._of_class(batch_kernel.Contact, method)(Kind()) is None
