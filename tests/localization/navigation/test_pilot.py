"""The pilot's decisions, on a robot that follows its commands: exact poses, a covariance and bumpers made up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, hypot, sin

import numpy as np
import pytest

from localization.filters.belief import Belief
from localization.filters.health import HEALTHY, FilterHealth, HealthStatus
from localization.live.estimate import Estimate
from localization.navigation.control_law import MODEL_LIMITS, STAND
from localization.navigation.obstacles import ObstacleTracker
from localization.navigation.path import wall_distances
from localization.navigation.pilot import Ending, Pilot, RetryPolicy
from localization.navigation.roadmap import MARGINS_IN, Planner
from nclient.protocol.types import N150 as MODEL
from nclient.state import RobotState
from worlds.io import load_world
from worlds.robots import N150

pytestmark = pytest.mark.long

WALLS = np.array(load_world("several_walls").walls)
PLANNER = Planner(WALLS, N150.radius_in)
WIDE = Planner(np.array(load_world("thesis_room").walls), N150.radius_in)
AXES = MODEL_LIMITS["n150"].capped(8.0)
Feels = Callable[[float, float, float], bool]
"""Return True if a bumper touches at (x, y), at a clock."""


class World:
    """A robot that jumps to its speeds, and knows its place to `std_in`."""

    def __init__(self, x: float = 5.0, y: float = 5.0, std_in: float = 0.1, feels: Feels = lambda *_: False) -> None:
        self.pose = np.array([x, y, 0.0])
        self.clock_s, self.std_in, self.feels = 0.0, std_in, feels
        self.health = HEALTHY
        self.obstacles = ObstacleTracker(WALLS, N150.sonar_ring_radius_in)
        self.least_room = np.inf

    def estimate(self) -> Estimate:
        cov = np.diag([self.std_in**2, self.std_in**2, 1e-4])
        return Estimate(self.clock_s, Belief(self.pose.copy(), cov), (), self.health)

    def state(self) -> RobotState:
        raw = [0] * 45
        raw[33] = int(self.feels(float(self.pose[0]), float(self.pose[1]), self.clock_s))
        raw[34], raw[35] = round(10 * self.pose[0]), round(10 * self.pose[1])
        return RobotState(MODEL, tuple(raw))

    def drive(self, pilot: Pilot, limit_s: float = 200.0) -> None:
        while pilot.result is None and self.clock_s < limit_s:
            command = pilot.step(self.estimate(), self.state())
            middle = self.pose[2] + 0.05 * command.steering_rad_s
            step = 0.1 * command.translation_in_s
            self.pose += [step * cos(middle), step * sin(middle), 0.1 * command.steering_rad_s]
            self.clock_s += 0.1
            self.least_room = min(self.least_room, float(wall_distances(self.pose[None, :2], WALLS)[0]))


def pilot_of(world: World, *goals: tuple[float, float], heading: float | None = None,
             policy: RetryPolicy | None = None) -> Pilot:  # fmt: skip
    return Pilot(PLANNER, AXES, world.obstacles, goals, heading, policy)


def ending(pilot: Pilot) -> Ending:
    assert pilot.result is not None
    return pilot.result.ending


def reason(pilot: Pilot) -> str:
    assert pilot.result is not None
    return pilot.result.reason


def test_pilot_arrives_and_turns_to_heading() -> None:
    world = World()
    pilot = pilot_of(world, (90.0, 55.0), heading=-2.0)
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    # Within an inch of the goal and 0.06 rad of the heading.
    assert hypot(*(world.pose[:2] - [90.0, 55.0])) < 1.0
    assert np.cos(world.pose[2] + 2.0) > np.cos(0.06)
    # The robot never touched a wall.
    assert world.least_room > N150.radius_in
    assert len(pilot.log.plans) == 1
    # After the end each step is a stand-still.
    assert pilot.step(world.estimate(), world.state()) == STAND


def test_path_points_are_passed_or_planned_one_by_one() -> None:
    world = World()
    pilot = pilot_of(world, (35.0, 55.0), (90.0, 55.0))
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    # One plan for both points.
    assert len(pilot.log.plans) == 1
    assert pilot.remaining_goals == ((90.0, 55.0),)
    # The second leg leads through a wall.
    blocked = World()
    pilot = pilot_of(blocked, (35.0, 55.0), (90.0, 0.0))
    blocked.drive(pilot)
    assert ending(pilot) is Ending.BLOCKED
    assert "comes within" in reason(pilot)


def test_a_find_in_the_path_is_gone_around() -> None:
    world = World()
    pilot = Pilot(WIDE, AXES, world.obstacles, [(40.0, 60.0)])
    world.drive(pilot, 3.0)
    # Four readings of weight 1 confirm an obstacle in the path.
    for _ in range(4):
        world.obstacles._add(25.0, 30.0, 1.0)
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    # The second plan leads around it.
    assert len(pilot.log.plans) == 2
    assert pilot.log.plans[1].length_in > 40.0


def test_path_points_with_a_find_between_are_gone_around_too() -> None:
    world = World()
    world.obstacles.add_contact(0.0, (20.0, 20.0), 1.0, 9.0)
    pilot = Pilot(WIDE, AXES, world.obstacles, [(35.0, 55.0), (60.0, 55.0)])
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    assert len(pilot.log.plans) >= 2


def test_pilot_waits_for_obstacle_then_gives_up_or_goes_on() -> None:
    world = World()
    pilot = pilot_of(world, (40.0, 60.0))

    # Contacts on four sides of the goal: no space there.
    def surround() -> None:
        for x, y in ((40.0, 50.0), (40.0, 70.0), (30.0, 60.0), (50.0, 60.0)):
            world.obstacles.add_contact(0.0, (x, y), 0.0, 0.0)

    surround()
    # It waits without giving up, and does not move.
    world.drive(pilot, 10.0)
    assert pilot.result is None
    assert hypot(*(world.pose[:2] - [5.0, 5.0])) == 0.0
    # Once they are removed it goes on.
    world.obstacles.clear()
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    world = World()
    pilot = pilot_of(world, (40.0, 60.0))
    surround()
    # Otherwise it gives up after 20 s.
    world.drive(pilot)
    assert ending(pilot) is Ending.BLOCKED
    assert "blocked by an obstacle that is not in the map: no space at (40, 60)" in reason(pilot)
    assert 20.0 <= world.clock_s < 23.0


def test_no_path_in_the_map_is_reported_at_once() -> None:
    world = World()
    pilot = pilot_of(world, (50.0, 30.0))
    world.drive(pilot)
    assert ending(pilot) is Ending.BLOCKED
    assert reason(pilot).startswith("no space at (50, 30): 0.0 in")
    assert world.clock_s < 0.2


def test_a_touch_is_backed_off_from_and_gone_around() -> None:
    touched = []

    def feels(x: float, y: float, _: float) -> bool:
        # A post that is not in the map, felt at a distance of 9.8 in.
        near = hypot(x - 22.0, y - 32.0) < 9.8
        touched.append(near)
        return near

    world = World(feels=feels)
    pilot = pilot_of(world, (40.0, 60.0), policy=RetryPolicy(max_touches=10))
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    # A few touches until its size is known.
    assert 1 <= len(pilot.log.touches) < 6
    assert sum(touched) < 40
    assert pilot.log.notes[0][1].startswith("touched something at")


def test_too_many_contacts_end_the_drive() -> None:
    world = World(feels=lambda *_: True)
    pilot = pilot_of(world, (40.0, 60.0))
    world.drive(pilot)
    assert ending(pilot) is Ending.TOUCHED
    assert "touched something 4 times" in reason(pilot)
    assert hypot(*(world.pose[:2] - [5.0, 5.0])) < 20.0


def test_failed_back_off_is_not_repeated() -> None:
    """The wheels turn, and the encoders stand: as on a robot that is held."""
    # Touching from 1 s on, whatever it does.
    world = World(feels=lambda _x, _y, clock: clock > 1.0)
    pilot = pilot_of(world, (40.0, 60.0), policy=RetryPolicy(max_touches=2, back_off_s=2.0))
    # The encoders never move.
    still = replace(world.state(), raw=(0,) * 33 + (1,) + (0,) * 11)
    for _ in range(60):
        pilot.step(world.estimate(), still)
        world.clock_s += 0.1
    assert ending(pilot) is Ending.TOUCHED
    # Not before the time of one back-off.
    assert world.clock_s >= 2.0


def test_an_uncertain_robot_slows_down_stands_and_gives_up() -> None:
    # 0.9 in of uncertainty slows it down.
    sure, unsure = World(), World(std_in=0.9)
    for world in (sure, unsure):
        world.drive(pilot_of(world, (90.0, 55.0)))
    assert unsure.clock_s > sure.clock_s + 2.0
    # 3 sigma of 12 in exceed any gap.
    hopeless = World(std_in=4.0)
    pilot = pilot_of(hopeless, (90.0, 55.0))
    hopeless.drive(pilot, 900.0)
    assert ending(pilot) is Ending.UNCERTAIN
    assert "uncertain by 12.0 in (3 sigma)" in reason(pilot)
    assert hopeless.least_room - N150.radius_in > 0.0
    # The reason is noted once per margin at most.
    assert 1 <= sum("too uncertain" in words for _, words in pilot.log.notes) < len(MARGINS_IN)


def test_uncertainty_that_passes_is_waited_for() -> None:
    world = World(std_in=3.0)
    pilot = pilot_of(world, (90.0, 55.0))
    world.drive(pilot, 8.0)
    assert pilot.result is None
    world.std_in = 0.1
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED


def test_lost_estimate_ends_the_drive() -> None:
    world = World()
    pilot = pilot_of(world, (90.0, 55.0))
    world.drive(pilot, 5.0)
    world.health = FilterHealth(HealthStatus.LOST, "searching")
    world.drive(pilot)
    assert pilot.result == (Ending.LOST, "searching")


def test_pilot_replans_off_path_limited_number_of_times() -> None:
    world = World()
    pilot = pilot_of(world, (90.0, 55.0))
    world.drive(pilot, 6.0)
    # The robot slips by 5.7 in.
    world.pose[:2] += [4.0, -4.0]
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    assert len(pilot.log.plans) == 2
    assert "beside the path" in pilot.log.notes[0][1]
    world = World()
    # A slip after each plan: it gives up after three.
    pilot = pilot_of(world, (90.0, 55.0), policy=RetryPolicy(max_plans=3))
    while pilot.result is None:
        world.drive(pilot, world.clock_s + 2.0)
        world.pose[:2] = [5.0, 5.0 + 6.0 * (len(pilot.log.plans) % 2)]
    assert ending(pilot) is Ending.ASTRAY
    assert reason(pilot) == "planned 3 times and not arrived"


def test_pilot_replans_if_path_ends_before_goal() -> None:
    world = World()
    pilot = pilot_of(world, (30.0, 30.0), policy=RetryPolicy(within_in=0.6))
    world.drive(pilot, 4.0)
    while hypot(*(world.pose[:2] - [30.0, 30.0])) > 0.5:
        world.drive(pilot, world.clock_s + 0.1)
        assert pilot.result is None
    # A slip of 1.3 in at the end of the path: beyond the goal's tolerance.
    world.pose[:2] += [0.9, 0.9]
    world.drive(pilot)
    assert ending(pilot) is Ending.ARRIVED
    assert hypot(*(world.pose[:2] - [30.0, 30.0])) <= 0.6
    assert len(pilot.log.plans) >= 2


def test_going_backwards_a_touch_is_behind() -> None:
    world = World()
    pilot = pilot_of(world, (90.0, 55.0))
    # The touch comes while it drives backwards.
    pilot._last_speed_in_s = -1.0
    world.feels = lambda *_: True
    pilot.step(world.estimate(), world.state())
    ((x1, _, x2, _),) = world.obstacles.confirmed
    # The obstacle is behind, at the rim.
    assert (x1, x2) == pytest.approx((5.0 - N150.radius_in,) * 2)
    world.feels = lambda *_: False
    # Released, it leaves forwards.
    assert pilot.step(world.estimate(), world.state()).translation_in_s > 0.0


def test_speed_is_reduced_near_obstacles() -> None:
    # A free stretch ahead, at full speed.
    world = World(30.0, 55.0)
    pilot = pilot_of(world, (90.0, 55.0))
    world.drive(pilot, 3.0)
    free = pilot.step(world.estimate(), world.state()).translation_in_s
    # An unconfirmed obstacle 25 in ahead reduces the speed.
    world.obstacles._add(float(world.pose[0]) + 25.0, 55.0, 0.0)
    suspicious = pilot.step(world.estimate(), world.state()).translation_in_s
    assert 0.0 < suspicious < 0.7 * free
    world.obstacles.clear()
    # One at the side does not.
    world.obstacles._add(float(world.pose[0]), 35.0, 0.0)
    assert pilot.step(world.estimate(), world.state()).translation_in_s == pytest.approx(free)
    # A confirmed one at the side does.
    for _ in range(3):
        world.obstacles._add(float(world.pose[0]), 36.0, 0.0)
    assert pilot.step(world.estimate(), world.state()).translation_in_s == pytest.approx(3.0)
