"""The guided run: UMBmark's square both ways round, and turns on the spot at its corners.

    place       the largest square along the axes of the map whose sides keep clear of all walls, near the robot
    way to it   the shortest, with room for a robot that errs
    tasks       Go(x, y): turn towards it on the spot, then roll; Spin(angle): turn on the spot
    driver      from a pose to the velocities of the task at hand

Ways are long and turns many, both ways round: errors of scale add up, those that cancel one way do not the other
(Borenstein and Feng 1996). Rules: pure; no robot, no filter.

As many laps as it takes: one each way, and again, until it is enough or there were too many.

Rules: values; what is enough is asked.

The guided run on a robot: drive the tasks on the estimate, hear, until all is done.

Rules: speaks to a robot through nclient's names only; waiting is handed in. The turret, where there is one, turns with
the steering, so that every sonar sees every wall.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from math import cos, hypot, pi, tau
from typing import Final, NamedTuple

import numpy as np

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import HEADING, Floats, wrap_angle
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule
from localization.navigation.path import waypoints
from localization.navigation.roadmap import NoPathError, Roadmap, clearances
from localization.navigation.speed import bearing_error, distance_to
from localization.navigation.waypoints import (
    COMMAND_TIMEOUT_S,
    PERIOD_S,
    SHORTEST_WAIT_S,
    Command,
    stop_on_exit,
)
from nclient.errors import NomadError
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.geometry import nearest_points
from worlds.world import World

MARGIN_IN: Final = 6.0
"""How far the sides keep from walls beyond the robot's radius: it errs, that is why it is here."""
WAY_MARGINS_IN: Final = (MARGIN_IN, 4.0, 2.0, 1.0)
"""Likewise on the way to the square; the last is the least."""
LARGEST_IN: Final = 160.0
SMALLEST_IN: Final = 12.0
_GRID_IN: Final = 4.0

AIMED_RAD: Final = 0.03
REACHED_IN: Final = 1.0
_FAR_OFF_RAD: Final = 0.5


class NoSquareError(NomadError):
    """There is no room for the guided run."""


class Go(NamedTuple):
    """To a point, by turning on the spot and rolling straight."""

    x_in: float
    y_in: float


class Spin(NamedTuple):
    """On the spot by so much, counter-clockwise."""

    angle_rad: float


Task = Go | Spin


class Square(NamedTuple):
    """A square along the axes: its lower left corner and its side, inches."""

    x_in: float
    y_in: float
    side_in: float

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Counter-clockwise."""
        x, y, side = self
        return (x, y), (x + side, y), (x + side, y + side), (x, y + side)


def largest_square(world: World, radius_in: float, near: tuple[float, float]) -> Square:
    """The largest square whose sides a robot of this radius can drive, the nearest of those to a point.

    Sides in steps of 4 in, 12 to 160. Raises NoSquareError.
    """
    room_in = radius_in + MARGIN_IN
    ends = world.walls.reshape(-1, 2)
    low, size = ends.min(axis=0), np.ceil(np.ptp(ends, axis=0) / _GRID_IN).astype(int) + 1
    along_x, along_y = np.indices(size)
    grid = low + _GRID_IN * np.stack((along_x, along_y), axis=-1)
    wide = nearest_points(grid.reshape(-1, 2), world.walls)[1].min(axis=-1).reshape(size) >= room_in
    for steps in range(min(int(LARGEST_IN / _GRID_IN), size.min() - 1), int(SMALLEST_IN / _GRID_IN) - 1, -1):
        whole = wide[:-steps, :-steps] & wide[steps:, :-steps] & wide[:-steps, steps:] & wide[steps:, steps:]
        squares = [Square(float(x), float(y), steps * _GRID_IN) for x, y in grid[:-steps, :-steps][whole]]
        for square in sorted(squares, key=lambda square: min(_far(corner, near) for corner in square.corners)):
            if is_clear(square, world, radius_in):
                return square
    raise NoSquareError(
        f"{world.name} has no room for a square of {SMALLEST_IN:g} in that keeps {MARGIN_IN:g} in from all walls: "
        "calibrate in a larger room"
    )


def is_clear(square: Square, world: World, radius_in: float) -> bool:
    """Whether a robot of this radius can drive its sides, and errs a little while it does."""
    room_in = radius_in + MARGIN_IN
    free = all(world.clearance(*corner) >= room_in for corner in square.corners)
    return free and bool((clearances(_sides(square), world.walls) >= room_in).all())


def _far(point: tuple[float, float], near: tuple[float, float]) -> float:
    return hypot(point[0] - near[0], point[1] - near[1])


def _sides(square: Square) -> Floats:
    corners = np.array(square.corners)
    return np.concatenate((corners, np.roll(corners, -1, axis=0)), axis=1)


def tasks(square: Square, near: tuple[float, float], laps: int, spins: int) -> list[Task]:
    """So many laps each way from the corner that is nearest, with `spins` turns on the spot at each corner."""
    corners = list(square.corners)
    first = min(range(len(corners)), key=lambda number: _far(corners[number], near))
    found: list[Task] = [Go(*corners[first])]
    for way in (1, -1):
        for side in range(len(corners) * laps):
            found += [Spin(way * tau * spins)] if spins else []
            found.append(Go(*corners[(first + way * (side + 1)) % len(corners)]))
    return found


def way_to(goal: tuple[float, float], start: tuple[float, float], world: World, radius_in: float) -> list[Go]:
    """The shortest way from where the robot stands, with as much room of WAY_MARGINS_IN as there is. Raises
    NoPathError."""
    *wide, least_in = WAY_MARGINS_IN
    for margin_in in wide:
        with suppress(NoPathError):
            return _way(goal, start, world, radius_in + margin_in)
    return _way(goal, start, world, radius_in + least_in)


def _way(goal: tuple[float, float], start: tuple[float, float], world: World, room_in: float) -> list[Go]:
    return [Go(*point) for point in waypoints(Roadmap(world.walls, room_in).path(start, goal))]


class Driver:
    """From task to task. `more`: asked for tasks when all are done, until there are none."""

    def __init__(
        self, tasks: Sequence[Task], speed_in_s: float, turn_rad_s: float, more: Callable[[], Sequence[Task]] = tuple
    ) -> None:
        self._tasks, self._more = list(tasks), more
        self._speed_in_s, self._turn_rad_s = speed_in_s, turn_rad_s
        self.done = 0
        """How many tasks are behind."""
        self._aimed = False
        self._turned_rad = 0.0
        self._heading: float | None = None

    @property
    def count(self) -> int:
        """How many tasks are known of by now."""
        return len(self._tasks)

    @property
    def goal(self) -> Floats | None:
        """The place (2,) that it drives to; None while it turns on the spot, or is done."""
        task = self._tasks[self.done] if self.done < len(self._tasks) else None
        return np.array(task) if isinstance(task, Go) else None

    def command(self, pose: Floats) -> Command | None:
        """What to do at this pose (3,); None when all is done."""
        if self._heading is not None:
            self._turned_rad += float(wrap_angle(np.asarray(pose[HEADING] - self._heading)))
        self._heading = float(pose[HEADING])
        while self.done < len(self._tasks):
            task = self._tasks[self.done]
            command = self._spin(task) if isinstance(task, Spin) else self._go(pose, task)
            if command is not None:
                return command
            self.done += 1
            self._aimed, self._turned_rad = False, 0.0
            if self.done == len(self._tasks):
                self._tasks += self._more()
        return None

    def _spin(self, task: Spin) -> Command | None:
        left = task.angle_rad - self._turned_rad
        if left * task.angle_rad <= 0.0 or abs(left) < AIMED_RAD:
            return None
        return Command(0.0, self._towards(left))

    def _go(self, pose: Floats, task: Go) -> Command | None:
        goal = np.array(task)
        away, off = float(distance_to(pose, goal)), float(bearing_error(pose, goal))
        if away < REACHED_IN or (self._aimed and abs(off) > pi / 2 and away < 4.0 * REACHED_IN):
            return None
        self._aimed = abs(off) < (_FAR_OFF_RAD if self._aimed else AIMED_RAD)
        if not self._aimed:
            return Command(0.0, self._towards(off))
        return Command(min(self._speed_in_s, 0.5 + away) * max(cos(off), 0.0), self._towards(off))

    def _towards(self, off_rad: float) -> float:
        """A rate that comes to rest there."""
        return float(np.clip(2.0 * off_rad, -self._turn_rad_s, self._turn_rad_s))


class Rounds:
    """The laps after the first. `lap`: once each way; `most`: with the first; `enough`: asked after each."""

    def __init__(self, lap: Sequence[Task], most: int, enough: Callable[[], bool]) -> None:
        self._lap, self._most, self._enough = lap, most, enough
        self.begun = 1

    def more(self) -> Sequence[Task]:
        """What is to be driven now that all before is done; nothing where it is enough."""
        if self.begun >= self._most or self._enough():
            return ()
        self.begun += 1
        return self._lap


class Progress(NamedTuple):
    """A period of the run."""

    estimate: Estimate
    state: RobotState
    done: int


def run(
    robot: Robot, known: LocalizationConfig, method: Filter, driver: Driver, wait: Callable[[float], None]
) -> Generator[Progress, None, None]:
    """Drive until the driver is done, and tell of each period; the robot stands at the end, however it ends."""
    state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    localizer = Localizer(known, method.belief, FiringSchedule(state.clock_s), method)
    robot.set_timeout(COMMAND_TIMEOUT_S)
    with stop_on_exit(robot):
        while True:
            estimate = localizer.update(state)
            command = driver.command(estimate.pose)
            yield Progress(estimate, state, driver.done)
            if command is None:
                return
            after = _drive(robot, command)
            left_s = PERIOD_S - ((after.clock_s or 0.0) - (state.clock_s or 0.0))
            if left_s >= SHORTEST_WAIT_S:
                wait(left_s / (after.speed_factor or 1.0))
            state = robot.refresh()


def _drive(robot: Robot, command: Command) -> RobotState:
    rolled, turned = command
    if not robot.model.has_turret:
        return robot.drive(translation_in_s=rolled, steering_rad_s=turned)
    return robot.drive(translation_in_s=rolled, steering_rad_s=turned, turret_rad_s=turned)
