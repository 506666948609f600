"""Walkers: where they are, whom they stop for, what detects them, and that nothing depends on the caller's steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nserver_emu.simulation.batch import BatchSimulation
from nserver_emu.simulation.models import N150, N200
from nserver_emu.simulation.multi_robot import GAP_IN, SimulatedWalker, WalkerState
from nserver_emu.simulation.simulation import Simulation
from worlds.world import Door, Polygon, StartPose, Walker, WallAccuracy, World

ROOM = Polygon(((0.0, 0.0), (300.0, 0.0), (300.0, 200.0), (0.0, 200.0)), "hall")
SQUARE = ((50.0, 50.0), (150.0, 50.0), (150.0, 150.0), (50.0, 150.0))


def simulation(*walkers: Walker, doors: tuple[Door, ...] = (), start: StartPose | None = None) -> Simulation:
    """Return a hall with these walkers, and a robot at a start."""
    found = Simulation(World("hall", rooms=(ROOM,), walkers=walkers, doors=doors))
    if start:
        found.add_robot(1, start)
    return found


def along(points: list[tuple[float, float]], distance: float) -> tuple[float, float]:
    """Return the point so far along a polyline, in small steps: an oracle."""
    xs, ys = np.array(points).T
    at = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(xs), np.diff(ys)))))
    return float(np.interp(distance, at, xs)), float(np.interp(distance, at, ys))


@pytest.mark.long
@pytest.mark.parametrize("is_closed", [True, False])
def test_walker_is_where_its_speed_brings_it(is_closed: bool) -> None:
    run = simulation(Walker(SQUARE, 10.0, is_closed=is_closed))
    tour = [*SQUARE, SQUARE[0]] if is_closed else [*SQUARE, *SQUARE[-2::-1]]
    length = 400.0 if is_closed else 600.0
    for _ in range(90):
        run.step(0.73)
        wanted = along(tour, 10.0 * run.time_s % length)
        assert run.walkers[0].disc == pytest.approx((*wanted, 7.0), abs=1e-8)


@pytest.mark.long
def test_steps_of_any_size_give_the_same_walk() -> None:
    runs = []
    for dt_s in (0.04, 0.2, 3.0):
        run = simulation(Walker(SQUARE, 71.0), Walker(SQUARE[::-1], 37.0), start=StartPose(100.0, 100.0))
        for _ in range(round(3.0 / dt_s)):
            run.step(dt_s)
        runs.append([*[walker.disc for walker in run.walkers], run.robots[1].sonar.readings_in])
    assert runs[0] == runs[1] == runs[2]


def test_walker_stops_before_a_robot_and_walks_on() -> None:
    run = simulation(Walker(((90.0, 100.0), (250.0, 100.0)), 20.0), start=StartPose(150.0, 100.0))
    run.step(6.0)
    radius = N150.body.radius_in
    x, y, _ = run.walkers[0].disc
    assert (150.0 - x, y) == pytest.approx((radius + 7.0 + GAP_IN, 100.0), abs=1e-6)
    # A sonar measures to the walker, where 6 in is the least, and no bumper is pressed.
    assert run.robots[1].sonar.readings_in[8] == 6
    assert run.robots[1].bumpers == 0
    run.place(1, 150.0, 150.0, 0.0, 0.0)
    run.step(1.0)
    assert run.walkers[0].disc[0] == pytest.approx(x + 20.0, abs=1e-6)


def test_robot_that_drives_at_a_walker_is_stopped_by_it() -> None:
    run = simulation(Walker(((50.0, 100.0), (250.0, 100.0)), 10.0), start=StartPose(170.0, 100.0))
    run.robots[1].set_velocities(-8.0, 0.0, 0.0)
    nearest = np.inf
    for _ in range(90):
        run.step(0.1)
        nearest = min(nearest, run.robots[1].actual.x_in - run.walkers[0].disc[0])
    assert nearest == pytest.approx(N150.body.radius_in + 7.0, abs=2e-3)
    assert run.robots[1].bumpers
    assert not any(run.robots[1].moving)


def test_infrared_and_laser_detect_walkers() -> None:
    far: list[float] = []
    near: list[float] = []
    for readings, x in ((far, 280.0), (near, 122.0)):
        run = Simulation(World("hall", rooms=(ROOM,), walkers=(Walker(((x, 90.0), (x, 110.0)), 0.1),)))
        robot = run.add_robot(1, StartPose(100.0, 95.0), N200)
        run.step(1.0)
        assert robot.infrared is not None
        readings += [float(robot.scan_laser().min()), min(robot.infrared.readings[:8])]
    assert near[0] < far[0]
    assert near[1] < far[1]


def test_closed_door_stops_walkers_and_sonars() -> None:
    door = Door("gate", ((150.0, 0.0), (150.0, 200.0)))
    route = Walker(((50.0, 100.0), (250.0, 100.0)), 20.0)
    run = simulation(route, doors=(door,), start=StartPose(50.0, 50.0))
    run.step(20.0)
    assert run.walkers[0].disc[0] == pytest.approx(150.0 - 3.5, abs=1e-6)
    closed_in = run.robots[1].sonar.readings_in[0]
    run.change_world(replace(run.world, doors=(replace(door, is_open=True),)))
    run.step(2.0)
    assert run.walkers[0].disc[0] == pytest.approx(150.0 - 3.5 + 40.0, abs=1e-6)
    assert run.robots[1].sonar.readings_in[0] > closed_in + 100.0


def test_snapshot_continues_the_walk() -> None:
    def walk() -> Simulation:
        return simulation(Walker(SQUARE, 13.0, is_closed=True), start=StartPose(100.0, 100.0))

    run, other = walk(), walk()
    for each in (run, other):
        each.step(3.3)
    other = Simulation.from_state(other.to_state())
    for each in (run, other):
        each.step(9.9)
    assert run.walkers[0].disc == other.walkers[0].disc
    assert run.robots[1].sonar.readings_in == other.robots[1].sonar.readings_in


def test_damaged_states_of_walkers_are_refused() -> None:
    state = simulation(Walker(SQUARE)).to_state()
    for wrong in (
        replace(state, walkers=None), replace(state, walkers=(WalkerState(-1),)),
        replace(state, world=replace(state.world, walkers=(Walker(SQUARE[:1]),))),
        replace(state, world=replace(state.world, doors=(Door("d", ((0.0, 0.0), (1.0, 1.0))),) * 1000)),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="walk"):
            Simulation.from_state(wrong)


def test_robot_stands_alone_after_the_last_walker_left() -> None:
    run = simulation(Walker(((50.0, 100.0), (250.0, 100.0))), start=StartPose(150.0, 60.0))
    alone = simulation(start=StartPose(150.0, 60.0))
    for each in (run, alone):
        each.step(1.0)
    run.change_world(replace(run.world, walkers=()))
    for each in (run, alone):
        each.step(5.0)
    assert run.robots[1].sonar.readings_in == alone.robots[1].sonar.readings_in
    assert run.bodies == [run.robots[1]]


def test_snapshot_after_the_last_walker_left_is_restored() -> None:
    run = simulation(Walker(((50.0, 100.0), (250.0, 100.0))), start=StartPose(150.0, 60.0))
    run.step(1.0)
    run.change_world(replace(run.world, walkers=()))
    run.step(1.0)
    assert Simulation.from_state(run.to_state()).robots[1].actual == run.robots[1].actual


@pytest.mark.long
def test_slowest_walker_stands() -> None:
    for speed in (1e-9, 5e-324):
        run = simulation(Walker(SQUARE, speed, is_closed=True), start=StartPose(250.0, 100.0))
        run.step(60.0)
        assert run.walkers[0].disc[:2] == pytest.approx(SQUARE[0], abs=1e-6)


def test_path_of_a_walker_without_robots_is_not_stored() -> None:
    run = simulation(Walker(SQUARE, 100.0))
    for _ in range(100):
        run.step(0.1)
    assert len(run.walkers[0]._pieces) <= 1


def test_snapshot_has_the_accuracies_of_walls() -> None:
    rows = np.array([[100.0, 50.0, 200.0, 50.0], [100.0, 150.0, 200.0, 150.0]])
    measured = {1: WallAccuracy(0.1, 0.01, 80.0)}
    state = Simulation(World("hall", rooms=(ROOM,), inner_walls=rows, accuracies=measured)).to_state()
    assert Simulation.from_state(state).world.accuracies == measured
    for wrong in ({2: measured[1]}, {0: WallAccuracy(-0.1, 0.01, 80.0)}):
        with pytest.raises(ValueError, match="accuracy"):
            Simulation.from_state(replace(state, world=replace(state.world, accuracies=wrong)))


def test_walkers_pass_one_another() -> None:
    run = simulation(Walker(((50.0, 100.0), (250.0, 100.0))), Walker(((250.0, 100.0), (50.0, 100.0))))
    run.step(10.0)
    assert [walker.disc[0] for walker in run.walkers] == pytest.approx([250.0, 50.0])


def test_position_within_a_span_follows_from_the_pieces() -> None:
    walker = SimulatedWalker(Walker(SQUARE, 100.0), np.empty((0, 4)))
    walker.start_trajectory()
    walker.advance_to(1_500_000_000_000)
    assert walker.disc_at(1_250_000_000_000)[:2] == pytest.approx((150.0, 75.0))
    assert walker.disc_at(500_000_000_000)[:2] == pytest.approx((100.0, 50.0))


def test_batch_refuses_walkers() -> None:
    with pytest.raises(ValueError, match="walkers"):
        BatchSimulation(simulation(Walker(SQUARE)).world, robots=1)
