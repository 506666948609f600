"""Driving while the map grows: the speed guard, legs, and whole drives by `nomad map learn ADDRESS`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, radians, sin
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from localization.cli.map_learn import recorded_address
from localization.filters.belief import Floats
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.live import LiveMapper
from localization.mapping.measurements import DriveCollector, DriveLog, compare_rounds, read_drive
from localization.mapping.survey import (
    GAP_IN_S,
    MIN_SPEED_IN_S,
    REACTION_S,
    Geofence,
    Plan,
    SpeedGuard,
    SurveyStep,
    WaypointDriver,
    _Leg,
    _Motion,
    survey,
)
from localization.navigation.control_law import MODEL_LIMITS, VelocityCommand
from nclient import Robot, connect
from nclient.cli import main
from nclient.errors import BumperHit
from nclient.recording.format import read_recording
from nclient.state import RobotState
from tests.localization.mapping.drives import drive, echo
from tests.localization.viewer_stub import page_that
from tests.programs.forked import Forked
from worlds.io import load_world
from worlds.robots import N150

STAND = np.zeros(4)
FOUR = ["35,15", "60,60", "10,60", "10,15"]


def guard(*readings: tuple[float, float, float]) -> SpeedGuard:
    """Return a guard with readings of time, axis and range at the origin."""
    made = SpeedGuard(N150)
    for clock_s, axis, reading in readings:
        made.add(clock_s, STAND, axis, reading)
    return made


def test_free_way_ends_at_the_wall_ahead() -> None:
    # Face of the sonar at 9.06 in, body of 9.72 in, margin of 1.5 in.
    assert guard((0.0, 0.0, 30.0)).free_in(STAND, 0.0) == pytest.approx(30.0 + 9.06 - 9.72 - 1.5)
    moved = np.array((10.0, 0.0, 0.0, 0.0))
    assert guard((0.0, 0.0, 30.0)).free_in(moved, 0.0) == pytest.approx(17.84)


def test_what_lies_behind_or_aside_leaves_the_way_free() -> None:
    assert guard((0.0, pi, 7.0), (0.1, 1.7, 7.0)).free_in(STAND, 0.0) == np.inf
    assert guard((0.0, 0.0, 7.0), (3.0, pi, 30.0)).free_in(STAND, 0.0) == np.inf


def test_dead_zone_blocks_ahead_but_not_beside() -> None:
    assert guard((0.0, 0.3, 6.0)).free_in(STAND, 0.0) == 0.0
    assert guard((0.0, pi / 2.0, 6.0)).free_in(STAND, 0.0) == np.inf


def test_near_wall_whose_echo_vanishes_is_remembered() -> None:
    # At 10 in, then the robot comes 5 in nearer and its sonar measures nothing.
    nearer, nothing = np.array((5.0, 0.0, 0.0, 0.0)), N150.ring.max_range_in
    silent = guard((0.0, 0.0, 10.0), (1.0, 0.0, nothing), (2.0, 0.0, nothing), (3.0, 0.0, nothing))
    left_in = 10.0 + N150.ring.radius_in - N150.radius_in - 1.5
    assert silent.free_in(nearer, 0.0) == pytest.approx(left_in - 5.0)
    # Not one that was far, nor of a sonar that does not fire.
    for readings in ([(0.0, 0.0, 25.0), (1.0, 0.0, nothing)], [(0.0, 0.0, 10.0), (1.0, pi, nothing)]):
        assert guard(*readings, (3.0, pi, nothing)).free_in(nearer, 0.0) > 200.0
    # Until the sonar measures something, or 4 s have passed.
    silent.add(3.5, nearer, 0.0, 60.0)
    assert silent.free_in(nearer, 0.0) == pytest.approx(60.0 - 10.0 + left_in)
    silent = guard((0.0, 0.0, 10.0), (1.0, 0.0, nothing), (3.0, 0.0, nothing), (4.1, 0.0, nothing))
    assert silent.free_in(nearer, 0.0) > 200.0


def test_an_echo_replaces_what_is_remembered_at_once() -> None:
    # The near reading grows too old in the same call in which its sonar measures 60 in.
    nothing = N150.ring.max_range_in
    made = guard((0.0, 0.0, 10.0), (1.0, 0.0, nothing), (2.5, 0.0, 60.0))
    made.add(3.5, STAND, 0.0, 60.0)
    assert made.free_in(STAND, 0.0) == pytest.approx(60.0 + N150.ring.radius_in - N150.radius_in - 1.5)


def test_near_wall_is_remembered_while_the_ring_turns() -> None:
    # A sonar that has turned by 10 degrees is the one that looks there now; one at 22.5 degrees is another.
    nothing = N150.ring.max_range_in
    for turned_deg, is_remembered in ((10.0, True), (22.5, False)):
        made = guard((0.0, 0.0, 10.0), (1.0, np.radians(turned_deg), nothing), (2.5, pi, nothing))
        assert (made.free_in(STAND, 0.0) < 20.0) is is_remembered


NOTHING_IN = N150.ring.max_range_in


@pytest.mark.parametrize(("first_in", "moved_in", "later_in", "after_s", "is_remembered"), [
    (9.0, 0.0, NOTHING_IN, 25.0, True),  # two readings agree, and the robot stands or turns
    (9.0, 5.0, NOTHING_IN, 25.0, True),
    (9.0, 7.0, NOTHING_IN, 25.0, False),  # it has gone
    (9.0, 0.0, NOTHING_IN, 31.0, False),
    (20.0, 0.0, NOTHING_IN, 25.0, False),  # one reading alone may be a bad one
    (20.0, 0.0, NOTHING_IN, 3.5, True),
    (9.0, 0.0, 80.0, 3.5, True),  # the edge of a box, past which the wall behind it is measured
    (9.0, 0.0, 80.0, 4.5, False),  # then it was somebody who has walked on
    (20.0, 0.0, 80.0, 3.5, False),
])  # fmt: skip
def test_near_edge_that_two_readings_have_shown_is_remembered_here(
    first_in: float, moved_in: float, later_in: float, after_s: float, is_remembered: bool
) -> None:
    # An edge ahead at 7 in, of which nothing returns any more; 2 in before the readings the robot was farther away.
    made = SpeedGuard(N150)
    made.add(0.0, np.array((-2.0, 0.0, 0.0, 0.0)), 0.0, first_in)
    made.add(1.0, STAND, 0.0, 7.0)
    place = np.array((0.0, moved_in, 0.0, 0.0))
    for clock_s in np.arange(2.0, 1.1 + after_s, 0.5):
        made.add(float(clock_s), place, 0.0, later_in)
    assert (made.free_in(place, 0.0) < 5.0) is is_remembered


@pytest.mark.parametrize("x_in", [0.0, 200.0, -700.0])
def test_near_edge_is_remembered_wherever_the_encoders_begin(x_in: float) -> None:
    # Two readings of 7 in, between which the ring has turned by 0.1 rad.
    place, nothing = np.array((x_in, 30.0, 0.0, 0.0)), N150.ring.max_range_in
    made, other = SpeedGuard(N150), SpeedGuard(N150)
    for each, first_in in ((made, 7.0), (other, 22.0)):
        each.add(0.0, place, 0.0, first_in)
        each.add(1.0, place, 0.1, 7.0)
        for clock_s in range(2, 10):
            each.add(float(clock_s), place, 0.1, nothing)
    assert made.free_in(place, 0.0) < 5.0
    assert other.free_in(place, 0.0) > 200.0


def test_wall_that_has_become_too_near_to_measure_is_where_it_was_measured() -> None:
    # 8 in to the left of the ring; then the robot is 3 in nearer, and drives on for 10 s.
    made, limit_in = SpeedGuard(N150), N150.ring.min_range_in
    made.add(0.0, STAND, 0.5 * pi, 8.0)
    for step in range(1, 10):
        made.add(float(step), np.array((2.0 * step, 3.0, 0.0, 0.0)), 0.5 * pi, limit_in)
    here = np.array((18.0, 3.0, 0.0))
    # Ten degrees to the left, the wall 67.5 degrees aside of the direction with half of the cone.
    left_in = N150.ring.radius_in + 8.0 - 3.0 - N150.radius_in - 1.5
    assert made.free_in(here, radians(10.0)) == pytest.approx(left_in / np.cos(radians(67.5)))
    assert made.is_blind
    # Away from it nothing is in the way, and a reading shows that it has gone.
    assert made.free_in(here, radians(-10.0)) == np.inf
    made.add(10.0, np.append(here, 0.0), 0.5 * pi, 20.0)
    made.add(12.5, np.append(here, 0.0), 0.5 * pi, 20.0)
    assert made.free_in(here, radians(10.0)) > 20.0


def test_wall_too_near_to_measure_is_forgotten_after_20_in() -> None:
    # It may not be across the axis: parallel to the way it would come to lie within the robot.
    made, limit_in = SpeedGuard(N150), N150.ring.min_range_in
    made.add(0.0, STAND, radians(75.0), 7.0)
    found = []
    for step in range(1, 41):
        pose = np.array((1.5 * step, 0.0, 0.0, 0.0))
        made.add(float(step), pose, radians(75.0), limit_in)
        found.append((float(pose[0]), made.free_in(pose, 0.0)))
    assert all(free < np.inf for x, free in found if 3.0 < x < 20.0)
    assert all(free == np.inf for x, free in found if x > 27.0)


def trail_to_here(from_in: float, *, rays: bool = False) -> SpeedGuard:
    """Return a guard that has come along the x axis, with a wall to the left that it measures at the lower limit."""
    made = SpeedGuard(N150, rays=rays)
    for step, x in enumerate(np.arange(from_in, 0.25, 0.5)):
        axis = np.radians(60.0 + step % 3 * 30.0)
        made.add(0.1 * step, np.array((x, 0.0, 0.0, 0.0)), axis, N150.ring.min_range_in)
    return made


@pytest.mark.parametrize("rays", [False, True])
def test_robot_goes_back_along_a_wall_too_near_to_measure(rays: bool) -> None:
    made = trail_to_here(-10.0, rays=rays)
    assert made.free_in(STAND, 0.0) == 0.0
    assert made.free_in(STAND, pi) == np.inf
    assert made.is_blind
    # Not where it has not been, or where something is straight ahead.
    assert made.free_in(np.array((-10.0, 0.0, 0.0)), pi) == 0.0
    made.add(2.1, STAND, np.radians(175.0), 6.0)
    assert made.free_in(STAND, pi) == 0.0


def test_robot_goes_back_as_far_as_the_trail_reaches() -> None:
    # 60 in, however long it has stood: points half an inch apart.
    made = trail_to_here(-80.0)
    for clock_s in range(20, 80):
        made.add(float(clock_s), STAND, np.radians(130.0), 6.0)
    for at_in, free in ((-50.0, np.inf), (-57.5, np.inf), (-58.5, 0.0)):
        assert made.free_in(np.array((at_in, 0.0, 0.0)), pi) == free
    # The end of a step of 2 in is at most 0.7 in beside it.
    assert made.comes_from(STAND, pi + 0.3)
    assert not made.comes_from(STAND, pi + 0.4)


@pytest.mark.parametrize(("before_in", "at_in", "is_free"), [
    (30.0, 0.0, False),  # it has come nearer while the robot stood
    (9.5, 0.0, False),
    (8.0, 0.0, True),  # noise
    (30.0, -4.0, True),  # the robot has come nearer to it
    (255.0, 0.0, True),  # there was no echo
])  # fmt: skip
@pytest.mark.parametrize("turned_rad", [0.0, 0.17])
def test_what_comes_beside_the_robot_keeps_it_from_going_back(
    before_in: float, at_in: float, is_free: bool, turned_rad: float
) -> None:
    made, axis = trail_to_here(-10.0), np.radians(-120.0)
    made.add(3.0, np.array((at_in, 0.0, 0.0, 0.0)), axis, before_in)
    made.add(4.0, STAND, axis + turned_rad, 6.0)
    # A ring that has turned measures something else.
    assert (made.free_in(STAND, pi) > 0.0) is (is_free or turned_rad > 0.0)


def test_robot_does_not_go_back_to_what_it_touched() -> None:
    # It has touched something at x = -12, was pushed back by 3 in and goes on by 12 in beside something near.
    made = SpeedGuard(N150)
    made.on_contact(np.array((-12.0, 0.0, 0.0)))
    for step in range(25):
        made.add(0.1 * step, np.array((-12.0 + 0.5 * step, 0.0, 0.0, 0.0)), np.radians(120.0), 6.0)
    # Away from there, as far as it was, and back to within 5 in of it.
    for x, direction, free in ((0.0, pi, np.inf), (-4.0, pi, np.inf), (-6.0, pi, 0.0), (-11.0, 0.0, np.inf)):
        assert made.free_in(np.array((x, 0.0, 0.0)), direction) == free
    assert made.comes_from(np.array((-11.0, 0.0, 0.0)), 0.0)


def test_geofence_contains_its_inside() -> None:
    fence = Geofence((-5.0, -5.0), (5.0, 10.0))
    assert fence.contains(0.0, 9.0)
    assert not fence.contains(0.0, 11.0)


def test_guard_is_complete_after_a_turn_of_the_ring() -> None:
    readings = [(0.06 * number, 0.4 * number, 50.0) for number in range(16)]
    assert not guard(*readings[:15]).is_complete(0.9)
    assert guard(*readings).is_complete(0.9)
    # Readings that have stopped show nothing of what is ahead now.
    assert not guard(*readings).is_complete(2.5)


# Robots that were moved.


def standing_rounds(log: DriveLog, seed: int, moved: tuple[float, float, float], bad: float) -> DriveLog:
    """Return two rounds at the end of the true lap, displaced ahead, to the left and by an angle, with bad readings."""
    rng = np.random.default_rng(seed)
    heading = log.encoders[-1, 3] - 0.4
    x = 25.0 + cos(heading) * moved[0] - sin(heading) * moved[1]
    y = 30.0 + sin(heading) * moved[0] + cos(heading) * moved[1]
    ring, readings = N150.sonar_ring_radius_in, []
    for angle in N150.sonar_angles_rad * 2:
        axis = heading + moved[2] + angle
        found = echo(x + ring * cos(axis), y + ring * sin(axis), axis)
        found = float(rng.integers(7, 200)) if rng.random() < bad else found
        readings.append(found if found >= 255.0 else float(round(found + rng.normal(0.0, 0.01 * found))))
    # Encoders that were set anew meanwhile.
    encoders = np.array([(0.0, 1.0, 2.0, 0.3, 0.3), (2.0, 1.0, 2.0, 0.3, 0.3)])
    return replace(
        log, encoders=encoders, instants_s=np.linspace(0.1, 1.9, 32), sonars=np.arange(32) % 16,
        readings_in=np.array(readings),
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("bad", [0.0, 0.2])
def test_robot_that_stands_where_it_stood_fits(bad: float) -> None:
    log = drive(quiet=True)
    rng = np.random.default_rng(3)
    worse = np.where(rng.random(len(log.readings_in)) < bad, rng.uniform(7.0, 200.0, len(log.readings_in)),
                     log.readings_in)  # fmt: skip
    log = replace(log, readings_in=worse)
    for seed in range(40):
        assert not compare_rounds(log, standing_rounds(log, seed, (0.0, 0.0, 0.0), bad), ConeSonar()).has_moved


@pytest.mark.long
@pytest.mark.parametrize("moved", [(9.0, 0.0, 0.0), (0.0, -9.0, 0.0), (-6.0, 7.0, 0.0), (40.0, -30.0, 2.0)])
def test_robot_that_was_moved_does_not_fit(moved: tuple[float, float, float]) -> None:
    log = drive(quiet=True)
    for seed in range(20):
        found = compare_rounds(log, standing_rounds(log, seed, moved, 0.0), ConeSonar())
        assert found.has_moved
        if abs(moved[0]) < 12.0:
            np.testing.assert_allclose(found.displacement_in, moved[:2], atol=2.5)


def test_turret_in_another_direction_does_not_fit() -> None:
    log = drive(quiet=True)
    after = standing_rounds(log, 0, (0.0, 0.0, 0.0), 0.0)
    # By half of the angle between two sonars: none measures where one measured before.
    after.encoders[:, 4] += pi / 16.0
    found = compare_rounds(log, after, ConeSonar())
    assert found.compared >= 4
    assert found.agreeing == 0
    assert found.has_moved


def test_round_without_echoes_decides_nothing() -> None:
    log = drive(quiet=True)
    nothing = replace(log, readings_in=np.full(len(log.readings_in), 255.0))
    found = compare_rounds(nothing, nothing, ConeSonar())
    assert found.compared == 0
    assert not found.has_moved


# Robots with a fault.


class Faulty:
    """A robot whose states are changed, and whose commands are listed; without motors it does not drive."""

    def __init__(self, robot: Robot, change: Callable[[int, RobotState], RobotState], *, has_motors: bool) -> None:
        self._robot, self._change, self._has_motors = robot, change, has_motors
        self.states, self.speeds = 0, list[float]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    def refresh(self) -> RobotState:
        self.states += 1
        return self._change(self.states, self._robot.refresh())

    def drive(self, *, translation_in_s: float, steering_rad_s: float) -> RobotState:
        self.speeds.append(translation_in_s)
        factor = 1.0 if self._has_motors else 0.0
        after = self._robot.drive(translation_in_s=factor * translation_in_s, steering_rad_s=factor * steering_rad_s)
        return self._change(self.states, after)


def unchanged(_: int, state: RobotState) -> RobotState:
    return state


def surveyed(
    address: str, change: Callable[[int, RobotState], RobotState], *, has_motors: bool = True, limit_s: float = 20.0
) -> tuple[SurveyStep, Faulty]:
    """Drive to a waypoint; return the last period and the robot."""

    def mapper_of(collector: DriveCollector) -> LiveMapper:
        return LiveMapper(collector, OdometryNoise(), ConeSonar(), rays=False, roughness_in=0.15)

    limits = MODEL_LIMITS["n150"].capped(6.0, 0.6)
    with connect(address) as robot:
        faulty = Faulty(robot, change, has_motors=has_motors)
        for step, _, _ in survey(
            cast("Robot", faulty), N150, mapper_of, WaypointDriver([(35.0, 15.0)]), limits, lambda _: None
        ):
            if step.elapsed_s > limit_s:
                break
    return step, faulty


def test_leg_drives_through_its_corners_and_ends_near_its_goal() -> None:
    nowhere, limits = np.zeros((0, 4)), MODEL_LIMITS["n150"].capped(6.0, 0.6)
    plan = Plan([(30.0, 0.0), (50.0, 15.0)])
    leg = _Leg(np.zeros(3), plan, limits, nowhere, N150.radius_in)
    pose, slowest = np.zeros(3), 99.0
    while (command := leg.command(pose)) is not None:
        moved = 0.1 * command.translation_in_s
        pose += np.array((moved * cos(pose[2]), moved * sin(pose[2]), 0.1 * command.steering_rad_s))
        if np.hypot(*(pose[:2] - (30.0, 0.0))) < 6.0:
            slowest = min(slowest, command.translation_in_s)
    assert slowest > 2.0
    assert 0.25 < np.hypot(*(pose[:2] - (50.0, 15.0))) < 1.1
    # Not where an arc would lead past a wall: then it turns in place.
    leg = _Leg(np.zeros(3), plan, limits, np.array([(28.0, 10.5, 28.0, 20.0)]), N150.radius_in)
    assert len(leg._sections) == 2
    # Nothing to drive.
    assert _Leg(np.zeros(3), Plan([(0.3, 0.0)]), limits, nowhere, N150.radius_in).command(np.zeros(3)) is None


def test_drive_ends_when_the_clock_goes_back() -> None:
    def restarted(number: int, state: RobotState) -> RobotState:
        return RobotState(state.model, state.raw, clock_ms=(state.clock_ms or 0) - (2000 if number > 20 else 0))

    step, robot = surveyed("sim:thesis_room?setup=measured&seed=4&step_s=0.1", restarted)
    assert "clock" in step.ended
    assert robot.states == 21


@pytest.mark.long
def test_drive_ends_when_the_robot_does_not_move() -> None:
    step, robot = surveyed("sim:thesis_room?setup=measured&seed=4&step_s=0.1", unchanged, has_motors=False)
    assert "does not move" in step.ended
    assert step.elapsed_s < 10.0
    assert robot.speeds


def test_bumper_hit_is_a_contact() -> None:
    # As bumper_stop reports it on serial lines: the bumper may be open again in the next state.
    def hit(number: int, state: RobotState) -> RobotState:
        if number == 20:
            raise BumperHit("gs", (3,))
        return state

    step, robot = surveyed("sim:thesis_room?setup=measured&seed=4&step_s=0.1", hit, limit_s=6.0)
    assert not step.ended
    assert min(robot.speeds) < 0.0


def test_robot_that_begins_in_contact_backs_off_to_space() -> None:
    def touching(number: int, state: RobotState) -> RobotState:
        raw = (*state.raw[:33], 1, *state.raw[34:])
        return RobotState(state.model, raw, clock_ms=state.clock_ms) if number < 40 else state

    # The wall is ahead.
    _, robot = surveyed("sim:thesis_room?setup=measured&seed=4&step_s=0.1&start=92,60,0", touching, limit_s=4.0)
    first = next(speed for speed in robot.speeds if speed)
    assert first < 0.0


# Whole drives.


def learn(*words: str) -> int:
    return main.main(["map", "learn", *words])


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("survey")
    address = "sim:thesis_room?setup=measured&seed=4"
    with page_that(lambda _: (200, '{"waypoints": null, "set": 0}')) as (url, published):
        words = ("--waypoints", *FOUR, "--out", str(folder / "room.toml"), "--publish", url)
        assert learn(address, *words) in (0, 4)
    (folder / "published.json").write_text(json.dumps([message for _, message in published]))
    return folder


@pytest.mark.long
def test_drive_publishes_its_map_as_it_grows(driven: Path) -> None:
    messages = json.loads((driven / "published.json").read_text())
    assert messages[0]["began"]
    assert messages[0]["outcome"] == ""
    last = messages[-1]
    assert last["outcome"].startswith("Written to")
    assert len(messages[0]["walls"]) < len(last["walls"])
    # In the frame of the simulated world.
    true = load_world("thesis_room").walls.reshape(-1, 2)
    ends = np.array([wall["ends"] for wall in last["walls"]]).reshape(-1, 2)
    assert np.hypot(*(true[:, None] - ends).transpose(2, 0, 1)).min(axis=1).max() < 2.0


@pytest.mark.long
def test_live_drive_and_its_recording_give_the_same_map(
    driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "room.toml"
    assert learn("--from", str(driven / "room.log"), "--out", str(out), "--json") == 0
    assert out.read_text() == (driven / "room.toml").read_text()
    world = load_world(out)
    assert np.ptp(world.walls.reshape(-1, 2), axis=0) == pytest.approx(114.17, abs=2.0)
    assert json.loads(capsys.readouterr().out)["refused"] is None


@pytest.mark.long
def test_drive_goes_on_where_it_stopped(driven: Path) -> None:
    before = read_drive(driven / "room.log")
    both = read_drive(driven / "room.log", driven / "room.log")
    assert len(both.readings_in) == 2 * len(before.readings_in)
    assert (np.diff(both.encoders[:, 0]) > 0.0).all()
    np.testing.assert_allclose(both.encoders[len(before.encoders), 1:4], before.encoders[-1, 1:4])
    # The second part is the first one, moved.
    again = both.encoders[len(before.encoders) :, 1:3]
    np.testing.assert_allclose(
        np.hypot(*np.diff(again, axis=0).T), np.hypot(*np.diff(before.encoders[:, 1:3], axis=0).T), atol=1e-9
    )


@pytest.mark.long
def test_resumed_robot_that_was_moved_is_refused(
    driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # A simulation that starts anew has the robot at its start.
    words = ("sim:thesis_room?setup=measured&seed=9", "--resume", str(driven / "room.log"))
    assert learn(*words, "--out", str(tmp_path / "room.toml")) == 4
    assert "put the robot back" in capsys.readouterr().err
    assert not (tmp_path / "room.toml").exists()


def test_resumed_drive_waits_for_a_turn_of_the_ring(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    address, out = "sim:thesis_room?setup=measured&seed=4", ("--out", str(tmp_path / "room.toml"))
    first, second = tmp_path / "first.log", tmp_path / "second.log"
    assert learn(address, "--waypoints", "12,0", *out, "--record", str(first)) == 4
    x, y, heading = read_drive(first).encoders[-1, 1:4]
    start = f"&start={x:.2f},{y:.2f},{np.degrees(heading):.2f}"
    words = ("--resume", str(first), "--waypoints", "20,0", "--record", str(second))
    assert learn(address + start, *words, *out) == 4
    assert "driven for" in capsys.readouterr().out
    # Nothing is known of what is ahead before: states between conf_sn and the first motion.
    clocks = list[int]()
    for frame in (frame for entry in read_recording(second).entries for frame in entry.decoded):
        if frame.get("call") == "conf_sn":
            clocks = []
        if frame.get("call") == "vm" and any(int(speed) for speed in frame["args"]):
            break
        if frame.get("reply") == "state":
            clocks.append(int(frame["clock"]))
    assert clocks[-1] - clocks[0] > 900


@pytest.mark.long
@pytest.mark.long
def test_collector_ignores_states_that_are_old(driven: Path) -> None:
    collector = DriveCollector("n150", read_drive(driven / "room.log"))
    count = len(collector)
    with connect("sim:thesis_room") as robot:
        assert collector.add(robot.refresh()) == []
    assert len(collector) == count


@pytest.mark.long
def test_blocked_way_point_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    address = "sim:thesis_room?setup=measured&seed=4&start=80,80,0"
    code = learn(address, "--waypoints", "40,0", "--out", str(tmp_path / "room.toml"), "--speed", "9")
    text = capsys.readouterr().out
    assert code == 4
    assert "blocked" in text
    assert "waypoint (40, 0) left out" in text
    assert "contact" not in text


@pytest.mark.parametrize(("words", "reason"), [
    (["--waypoints", "90,0", "--geofence", "0,0,50,50"], "geofence"),
    (["--geofence", "10,10,50,50"], "start"),
    (["nserver://localhost:1/1?reconnect=5"], "reconnect"),
    (["--from", "drive.log", "--geofence", "0,0,50,50"], "--from"),
    (["--drive", "manual", "--waypoints", "9,0"], "manual"),
    (["--from", "drive.log", "--waypoints", "9,0"], "--from"),
])  # fmt: skip
def test_contradicting_options_are_refused(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        learn(*(words if "//" in words[0] else ["sim:thesis_room", *words]), "--out", str(tmp_path / "room.toml"))
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize("name", ["corridor8", "ring24"])
def test_other_rings_than_a_nomads_are_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = Path(__file__).parents[2] / "worlds" / "models" / f"{name}.toml"
    assert learn(f"sim:thesis_room?robot={name}&model_file={model}", "--out", str(tmp_path / "room.toml")) == 2
    assert "model_file=" in capsys.readouterr().err


@pytest.mark.parametrize(("address", "expected"), [
    ("serial:///dev/ttyUSB0", "serial:///dev/ttyUSB0?record=room.log&reconnect=0"),
    ("serial:///dev/ttyUSB0?record=room.log", "serial:///dev/ttyUSB0?record=room.log&reconnect=0"),
    ("serial:///dev/ttyUSB0?reconnect=0", "serial:///dev/ttyUSB0?reconnect=0&record=room.log"),
    ("nserver://localhost:7019/1", "nserver://localhost:7019/1?record=room.log"),
    ("sim:thesis_room?record=room.log", "sim:thesis_room?record=room.log"),
])  # fmt: skip
def test_drive_is_recorded_as_one_connection(address: str, expected: str) -> None:
    options = argparse.Namespace(address=address, record=None, out=Path("room.toml"))
    assert recorded_address(options, Path("room.toml")) == (expected, Path("room.log"))


@pytest.mark.long
def test_a_person_drives_over_a_socket(tmp_path: Path) -> None:
    record = tmp_path / "room.log"
    with Forked("nserver", "thesis_room", "--port", "0", "--setup", "measured", "--speed", "4") as server:
        address = f"nserver://{server.stdout.readline().split()[-1]}/1"
        words = (address, "--drive", "manual", "--time-limit", "16", "--out", str(tmp_path / "room.toml"))
        with Forked("nomad", "map", "learn", *words) as learner:
            first = learner.stdout.readline()
            with connect(address) as robot:
                robot.drive(translation_in_s=5.0, steering_deg_s=4.0)
                text = first + learner.stdout.read()
            assert learner.wait(60) == 4
        server.terminate()
        server.wait(20)
    assert "time limit" in text
    assert not {"\r", "\x1b"} & set(text)
    # It only observes: no motion command.
    calls = {frame["call"] for e in read_recording(record).entries for frame in e.decoded if "call" in frame}
    assert calls.isdisjoint({"vm", "pr", "pa", "ws", "st"})
    drive = read_drive(record)
    assert len(drive.readings_in) > 150
    assert np.ptp(drive.encoders[:, 1]) > 10.0


# What a map may overrule.


class SoundMap:
    """A map of one wall, 14 in to the left of the robot, measured as far as some distance ahead of it."""

    is_sound = True

    def __init__(self, ahead_in: float) -> None:
        self.walls = np.array([[-60.0, 14.0, ahead_in, 14.0]])
        self.poses = np.zeros((1, 3))
        self.is_facing = True

    def walls_facing(self, place: Floats) -> Floats:  # noqa: ARG002
        return self.walls if self.is_facing else np.zeros((0, 4))


@pytest.mark.parametrize(("axis_rad", "reading_in", "ahead_in", "fits"), [
    (pi / 2.0, 6.0, 60.0, True),  # the wall itself, which sonars measure as the lower limit
    (-pi / 2.0, 6.0, 60.0, False),  # something on the other side, which is not in the map
    (-pi / 2.0, 9.0, 60.0, False),
    (-pi / 2.0, 40.0, 60.0, True),
    (pi / 2.0, 6.0, -5.0, False),  # the same wall beyond the part of it that was measured so far
    (pi / 2.0, 40.0, -5.0, True),  # the end of the wall, with nothing beyond it
])  # fmt: skip
def test_a_map_overrules_readings_only_that_it_explains(
    axis_rad: float, reading_in: float, ahead_in: float, fits: bool
) -> None:
    measured = SpeedGuard(N150)
    motion = _Motion(WaypointDriver([]), measured, MODEL_LIMITS["n150"], None)
    # The encoders have another frame than the map: moved by (30, -20) and turned by 0.7 rad.
    encoders, pose = np.array((30.0, -20.0, 0.7)), np.zeros(3)
    measured.add(1.0, encoders, 0.7 + axis_rad, reading_in)
    mapper = SoundMap(ahead_in)
    assert (motion._gap_in_s(pose, encoders, 0.0, cast("LiveMapper", mapper)) > 0.0) is fits
    # The back of a wall may be nearer than the face that was measured.
    mapper.is_facing = False
    assert not motion._gap_in_s(pose, encoders, 0.0, cast("LiveMapper", mapper))


@pytest.mark.parametrize(("driven_in", "last_s", "fits"), [
    (0.0, 1.0, True),  # 24 in to the right is far
    (12.5, 1.0, False),  # now it is within 12 in, and the map does not have it
    (12.5, 3.5, False),  # its echo has vanished
    (12.5, 5.0, True),  # and longer ago than 4 s
])  # fmt: skip
def test_a_map_does_not_overrule_what_is_near_by_now(driven_in: float, last_s: float, fits: bool) -> None:
    measured = SpeedGuard(N150)
    motion = _Motion(WaypointDriver([]), measured, MODEL_LIMITS["n150"], None)
    measured.add(0.0, STAND, -pi / 2.0, 24.0)
    encoders = np.array((0.0, -driven_in, 0.0))
    for clock_s in np.arange(0.5, last_s, 0.5):
        measured.add(float(clock_s), encoders, -pi / 2.0, N150.ring.max_range_in)
    mapper = SoundMap(60.0)
    mapper.walls[:, [1, 3]] -= driven_in
    assert (motion._gap_in_s(encoders, encoders, 0.0, cast("LiveMapper", mapper)) > 0.0) is fits


@pytest.mark.parametrize(("width_in", "speed_in_s"), [
    (21.0, 0.0), (23.0, 2.0), (24.0, 2.0), (27.0, 4.5), (37.0, 4.5), (50.0, 0.0),
])
def test_a_door_of_the_map_is_passed_faster_than_a_gap(width_in: float, speed_in_s: float) -> None:
    motion = _Motion(WaypointDriver([]), SpeedGuard(N150), MODEL_LIMITS["n150"], None)
    mapper = SoundMap(60.0)
    # Both posts beside the robot, of walls across its way; 8 in beyond the door there is nothing.
    half = 0.5 * width_in
    mapper.walls = np.array([(0.5, half, 0.5, 60.0), (0.5, -60.0, 0.5, -half)])
    found = motion._gap_in_s(np.zeros(3), np.zeros(3), 0.0, cast("LiveMapper", mapper))
    assert found == speed_in_s
    # What has come between the robot and a post that is nearer than sonars measure would not show.
    motion._guard.add(0.0, np.zeros(3), pi / 2.0, 6.0)
    found = motion._gap_in_s(np.zeros(3), np.zeros(3), 0.0, cast("LiveMapper", mapper))
    assert found == (GAP_IN_S if 22.0 < width_in < 28.0 else 0.0)


@pytest.mark.parametrize("aside_in", [0.0, -3.0, 7.0])
def test_end_of_a_wall_of_the_map_stops_the_robot(aside_in: float) -> None:
    motion = _Motion(WaypointDriver([]), SpeedGuard(N150), MODEL_LIMITS["n150"], None)
    mapper = SoundMap(0.0)
    mapper.walls = np.array([[16.0, aside_in, 60.0, aside_in]])
    # The circle of the body and 0.8 in about it meets the end of the wall here, if not before.
    reach = N150.radius_in + 0.8
    until = 16.0 - (reach * reach - aside_in * aside_in) ** 0.5
    found = motion._free_of_map_in(np.zeros(3), 0.0, cast("LiveMapper", mapper))
    assert until - 0.5 <= found <= until
    # Away from it, and in a map that is not sound yet, it may move; from where it is too near only away.
    assert motion._free_of_map_in(np.zeros(3), pi, cast("LiveMapper", mapper)) == np.inf
    near = np.array((16.1 - reach, aside_in, 0.0))
    assert motion._free_of_map_in(near, 0.0, cast("LiveMapper", mapper)) == 0.0
    assert motion._free_of_map_in(near, pi, cast("LiveMapper", mapper)) == np.inf
    mapper.is_sound = False
    assert motion._free_of_map_in(np.zeros(3), 0.0, cast("LiveMapper", mapper)) == np.inf


def test_wall_where_the_robot_has_passed_does_not_stop_it() -> None:
    motion = _Motion(WaypointDriver([]), SpeedGuard(N150), MODEL_LIMITS["n150"], None)
    mapper = SoundMap(0.0)
    mapper.walls = np.array([[14.2, -60.0, 14.2, 60.0]])
    assert motion._free_of_map_in(np.zeros(3), 0.0, cast("LiveMapper", mapper)) < 4.0
    mapper.poses = np.array([(12.0 + 0.5 * step, 0.0, 0.0) for step in range(20)])
    assert motion._free_of_map_in(np.zeros(3), 0.0, cast("LiveMapper", mapper)) == np.inf
    # A hand's breadth aside the wall is still there.
    aside = np.array((0.0, 25.0, 0.0))
    assert motion._free_of_map_in(aside, 0.0, cast("LiveMapper", mapper)) < 4.0


def test_wall_too_near_to_measure_is_followed_for_8_in_in_all() -> None:
    # Short legs along a wall to the left that all readings show at the lower limit, then back.
    guard, driver = SpeedGuard(N150), WaypointDriver([(4.0, 0.0), (7.0, 0.0), (11.0, 0.0), (0.0, 0.0)])
    motion = _Motion(driver, guard, MODEL_LIMITS["n150"], None)
    mapper = SoundMap(0.0)
    mapper.is_sound = False
    pose, path = np.zeros(3), []
    for step in range(200):
        guard.add(0.1 * step, np.append(pose, 0.0), pi / 2.0, N150.ring.min_range_in)
        command = motion.command(0.1 * step, False, pose, pose, cast("LiveMapper", mapper))
        if not driver.remaining:
            break
        assert isinstance(command, VelocityCommand)
        assert abs(command.translation_in_s) < 3.01
        pose = pose + np.array((0.1 * command.translation_in_s, 0.0, 0.0))
        path.append(float(pose[0]))
    assert [point for point, _ in driver.skipped] == [(11.0, 0.0)]
    assert 8.0 < max(path) < 8.4
    assert path[-1] < 2.1


@pytest.mark.parametrize(("left_y_in", "slope", "other_y_in", "until_in"), [
    (13.0, 0.27, None, 2.0),  # a wall to the left that comes nearer by 15 degrees
    (13.0, 0.27, -20.0, 2.0),  # the wall to the right can be measured
    (13.0, 0.27, -14.0, 0.8),  # a gap
    (11.0, 0.0, None, None),  # a wall parallel to the way
])  # fmt: skip
def test_beside_one_wall_too_near_to_measure_the_map_leaves_more_space(
    left_y_in: float, slope: float, other_y_in: float | None, until_in: float | None
) -> None:
    guard, driver = SpeedGuard(N150), WaypointDriver([(20.0, 0.0)])
    motion = _Motion(driver, guard, MODEL_LIMITS["n150"], None)
    mapper = SoundMap(60.0)
    mapper.walls = np.array([(-60.0, left_y_in + 60.0 * slope, 60.0, left_y_in - 60.0 * slope)])
    if other_y_in is not None:
        mapper.walls = np.concatenate((mapper.walls, [(-60.0, other_y_in, 60.0, other_y_in)]))
    pose = np.zeros(3)
    for step in range(300):
        guard.add(0.1 * step, np.append(pose, 0.0), 0.5 * pi, N150.ring.min_range_in)
        command = motion.command(0.1 * step, False, pose, pose, cast("LiveMapper", mapper))
        if not driver.remaining:
            break
        assert isinstance(command, VelocityCommand)
        pose = pose + np.array((0.1 * command.translation_in_s, 0.0, 0.0))
    if until_in is None:
        assert pose[0] > 18.0
        return
    # What is left beside the body after the distance in which it would stop.
    assert driver.skipped == [((20.0, 0.0), "blocked")]
    ahead_in = REACTION_S * MIN_SPEED_IN_S
    left_in = (left_y_in - slope * (float(pose[0]) + ahead_in)) / (1.0 + slope**2) ** 0.5 - N150.radius_in
    assert until_in <= left_in < until_in + 0.15


class OnePlan:
    """A driver with one path."""

    def __init__(self, plan: Plan) -> None:
        self.plan: Plan | None = plan
        self.reason: str | None = None

    def leg(self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]) -> Plan | None:
        del clock_s, pose, mapper, free_in
        plan, self.plan = self.plan, None
        return plan

    def end_leg(self, pose: Floats, reason: str, direction_rad: float = 0.0) -> None:
        del pose, direction_rad
        self.reason = reason


def driven_with(
    plan: Plan, *readings: tuple[float, float], fence: Geofence | None = None
) -> tuple[str | None, list[tuple[float, float]]]:
    """Return how a path along the x axis ends, and times and places, with readings of axis and range at its start."""
    guard, driver = SpeedGuard(N150), OnePlan(plan)
    motion = _Motion(driver, guard, MODEL_LIMITS["n150"].capped(9.0, 0.8), fence)
    mapper = SoundMap(0.0)
    mapper.is_sound = False
    pose, path = np.zeros(3), [(0.0, 0.0)]
    for axis, reading in readings:
        guard.add(0.0, STAND, axis, reading)
    for step in range(1, 100):
        command = motion.command(0.1 * step, False, pose, pose, cast("LiveMapper", mapper))
        if driver.reason is not None:
            break
        assert isinstance(command, VelocityCommand)
        pose = pose + np.array((0.1 * command.translation_in_s, 0.0, 0.0))
        path.append((0.1 * step, float(pose[0])))
    return driver.reason, path


def test_optional_end_of_a_path_is_driven_slowly_as_far_as_it_is_free() -> None:
    # A wall 30 in before the sonar leaves 27.84 in; 6 in before that the path ends.
    reason, path = driven_with(Plan([(60.0, 0.0)], optional_in=45.0), (0.0, 30.0), (0.0, 30.0))
    assert reason == ""
    assert 30.0 + N150.ring.radius_in - N150.radius_in - 1.5 - 6.0 == pytest.approx(path[-1][1], abs=0.6)
    speeds = np.diff(np.array(path), axis=0) @ (0.0, 10.0)
    before = np.array(path)[:-1, 1] < 14.0
    assert speeds[before].max() > 8.0
    assert speeds[np.array(path)[:-1, 1] > 15.0].max() == pytest.approx(4.5)
    # Without anything ahead it is driven to its end; one reading may be a bad one.
    reason, path = driven_with(Plan([(25.0, 0.0)], optional_in=15.0))
    assert reason == ""
    assert path[-1][1] > 23.9
    assert driven_with(Plan([(60.0, 0.0)], optional_in=45.0), (0.0, 30.0))[0] == "blocked"
    # A path that comes back beside its optional end is not there yet.
    leg = _Leg(np.zeros(3), Plan([(60.0, 0.0), (60.0, 30.0), (0.0, 30.0)], optional_in=40.0), MODEL_LIMITS["n150"],
               np.zeros((0, 4)), N150.radius_in)  # fmt: skip
    places = ((0.0, 0.0), (60.0, 30.0), (41.0, 30.0), (39.0, 30.5))
    found = [leg.is_optional(np.array((*place, 0.0))) for place in places]
    assert found == [False, False, False, True]


def test_optional_end_of_a_path_ends_before_the_geofence() -> None:
    fence = Geofence((-50.0, -50.0), (40.0, 50.0))
    reason, path = driven_with(Plan([(39.0, 0.0)], optional_in=30.0), fence=fence)
    assert reason == ""
    # It may brake for 1.5 s at 4.5 in/s.
    assert path[-1][1] == pytest.approx(40.0 - 1.5 * 4.5, abs=0.5)
    assert driven_with(Plan([(60.0, 0.0)], waits=False), fence=fence)[0] == "blocked"


@pytest.mark.parametrize(("readings", "waits", "gives_up_s"), [
    ([(0.0, 6.0), (0.1, 6.0)], False, 0.1),  # two readings
    ([(0.0, 6.0)], False, 2.4),  # one may be bad
    ([(0.0, 6.0), (0.1, 6.0)], True, 2.4),  # somebody may go out of the way of a robot with waypoints
])  # fmt: skip
def test_blocked_path_is_given_up(readings: list[tuple[float, float]], waits: bool, gives_up_s: float) -> None:
    reason, path = driven_with(Plan([(60.0, 0.0)], waits=waits), *readings)
    assert reason == "blocked"
    assert path[-1][1] == 0.0
    assert path[-1][0] + 0.1 == pytest.approx(gives_up_s, abs=0.11)


def test_end_of_a_wall_between_two_rays_is_remembered() -> None:
    # A wall that begins at (30, 10.5), seen aslant from farther away, is beside all rays at (20, 0).
    rays, cones = SpeedGuard(N150, rays=True), SpeedGuard(N150)
    for each in (rays, cones):
        axis = float(np.arctan2(10.5, 30.0))
        each.add(0.0, np.array((0.0, 0.0, 0.0, 0.0)), axis, float(np.hypot(30.0, 10.5)) - N150.ring.radius_in - 13.0)
        each.add(0.1, np.array((13.0, 0.0, 0.0, 0.0)), float(np.arctan2(10.5, 17.0)), 11.0)
        for clock_s in (3.0, 4.0):
            each.add(clock_s, np.array((20.0, 0.0, 0.0, 0.0)), 0.0, 90.0)
    place = np.array((20.0, 0.0, 0.0))
    # The spot of the second ray: where the circle of the body and 1.5 in about it comes to lie on it.
    away = np.array((17.0, 10.5)) / np.hypot(17.0, 10.5) * (N150.ring.radius_in + 11.0) + (13.0, 0.0)
    reach = N150.radius_in + 1.5
    until = next(x for x in np.arange(20.0, 60.0, 0.001) if np.hypot(*(away - (x, 0.0))) <= reach)
    assert rays.free_in(place, 0.0) == pytest.approx(until - 20.0 - 1.5, abs=0.01)
    assert cones.free_in(place, 0.0) == pytest.approx(90.0 + N150.ring.radius_in - N150.radius_in - 1.5)
    # Behind it, beside it, and later nothing is there.
    assert rays.free_in(np.array((40.0, 0.0, 0.0)), 0.0) == pytest.approx(70.0 + N150.ring.radius_in - 11.22, abs=0.01)
    assert rays.free_of_spots_in(np.array((20.0, -5.0, 0.0)), 0.0) == np.inf
    rays.add(31.0, np.array((20.0, 0.0, 0.0, 0.0)), 0.0, 90.0)
    assert rays.free_of_spots_in(place, 0.0) == np.inf


def test_ray_at_the_lower_limit_ended_within_it() -> None:
    rays, cones = SpeedGuard(N150, rays=True), SpeedGuard(N150)
    for each in (rays, cones):
        each.add(0.0, STAND, np.radians(30.0), N150.ring.min_range_in)
    # Half of the 6 in counts: a spot 12.06 in from the axis, at 30 degrees.
    away = N150.ring.radius_in + 3.0
    reach = N150.radius_in + 1.5
    before = away * cos(np.radians(30.0)) - (reach**2 - (away * sin(np.radians(30.0))) ** 2) ** 0.5
    assert rays.free_of_spots_in(np.array((-5.0, 0.0, 0.0)), 0.0) == pytest.approx(5.0 + before - 1.5)
    assert cones.free_of_spots_in(np.array((-5.0, 0.0, 0.0)), 0.0) == np.inf
