"""Drive a square, estimate the systematic errors of wheels and sonars, write a model file.

    nomad calibrate nserver://localhost:7019/1 --map thesis_room --out mine.toml
    nomad calibrate "sim:thesis_room?setup=worn&seed=1" --out worn.toml --laps 2

The robot drives the square (UMBmark) in both directions and turns in place at its corners, while a filter estimates the
errors from the walls. Exit code 0: done; 3: given up; 4: the readings do not fit the sonar model, nothing is written.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import cos, degrees, dist, pi, radians, tau
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from localization.cli import arguments
from localization.filters.base import LocalizationConfig, sonar_of
from localization.filters.belief import HEADING, Belief, Floats, independent
from localization.filters.calibration import OFFSET, OWN, RING_TURN, CalibratingFilter
from localization.filters.odometry import OdometryParameter
from localization.live.assumptions import Consistency, resolve_body, resolve_robot_model
from localization.navigation.control_law import StallDetector, VelocityCommand, bearing_error, distance_to
from localization.navigation.path import TurnProgress, sample_waypoints
from localization.navigation.roadmap import NoPathError, Roadmap, segment_clearances
from localization.navigation.waypoints import follow_waypoints, start_localizer
from nclient import Robot
from nclient.common.arguments import add_address, add_flag, add_value, whole_number
from nclient.common.process import ExitCode
from nclient.errors import NomadError
from worlds.geometry import polygon_segments
from worlds.robots import Calibration, Spread, calibration_as_json, format_calibration
from worlds.world import World

# The guided calibration run: UMBmark's square in both directions, with turns in place at its corners.
#
#     square      the largest one parallel to the map's axes whose sides keep clear of all walls, near the robot
#     path        the shortest to the square, with space for an inaccurate robot
#     tasks       DriveTo(x, y): turn towards it in place, then roll; Spin(angle): turn in place
#     laps        one in each direction, and more until the result is accurate enough
#
# Long distances and many turns in both directions accumulate errors of scale; errors that cancel in one direction do
# not cancel in the other. The result is made of the belief of the calibrating filter: numbers with accuracies, and a
# table.
#
# References
# ----------
# Borenstein, Feng: Measurement and correction of systematic odometry errors in mobile robots (1996).

MARGIN_IN: Final = 6.0
"""Space between the sides and walls beyond the robot's radius: an uncalibrated robot is inaccurate."""
PATH_MARGINS_IN: Final = (MARGIN_IN, 4.0, 2.0, 1.0)
"""Space on the path to the square; the first that allows a path is used."""
MAX_SIDE_IN: Final = 160.0
MIN_SIDE_IN: Final = 12.0
# Grid of the search for a square: corners and sides are multiples of it.
_GRID_IN: Final = 4.0
# Less space than needed by this is left to the check of the whole square.
_ROUNDING_IN: Final = 1e-6
# Grid lines that are compared with all walls at a time.
_PART: Final = 4096

AIMED_RAD: Final = 0.03
"""A turn in place ends within this heading error."""
# A corner counts as reached within this distance, inches.
REACHED_IN: Final = 1.0
MAX_HEADING_ERROR_RAD: Final = 0.5
"""With a larger heading error the robot stops and turns in place."""


Counts = np.typing.NDArray[np.int_]


class NoSquareError(NomadError):
    """There is no space for the guided run."""


class DriveTo(NamedTuple):
    """Task: drive to a point, by turning in place and rolling straight."""

    x_in: float
    y_in: float


class Spin(NamedTuple):
    """Task: turn in place by an angle, counter-clockwise positive."""

    angle_rad: float


Task = DriveTo | Spin


class Square(NamedTuple):
    """A square parallel to the axes: lower left corner and side, inches."""

    x_in: float
    y_in: float
    side_in: float

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Corners, counter-clockwise."""
        x, y, side = self
        return (x, y), (x + side, y), (x + side, y + side), (x, y + side)


def largest_square(world: World, radius_in: float, near: tuple[float, float]) -> Square:
    """Return the largest square whose sides a robot can drive, the nearest one to a point.

    Parameters
    ----------
    world : World
    radius_in : float
        Radius of the robot.
    near : (x, y)

    Returns
    -------
    Square
        Its side is a multiple of 4 in, from 12 to 160.

    Raises
    ------
    NoSquareError
    """
    # 1. Grid points and grid lines between neighbours with enough space.
    space_in = radius_in + MARGIN_IN
    ends = world.walls.reshape(-1, 2)
    low, size = ends.min(axis=0), np.ceil(np.ptp(ends, axis=0) / _GRID_IN).astype(int) + 1
    grid = low + _GRID_IN * np.moveaxis(np.indices(size), 0, -1)
    clearances = world.clearances(grid)
    wide = clearances >= space_in - _ROUNDING_IN
    blocked_x = _count_blocked(grid, clearances, world, space_in)
    blocked_y = _count_blocked(grid.swapaxes(0, 1), clearances.T, world, space_in).T
    # 2. Squares whose corners and sides are free, the largest first; check each before it is returned.
    for steps in range(min(int(MAX_SIDE_IN / _GRID_IN), size.min() - 1), int(MIN_SIDE_IN / _GRID_IN) - 1, -1):
        whole = wide[:-steps, :-steps] & wide[steps:, :-steps] & wide[:-steps, steps:] & wide[steps:, steps:]
        along_x, along_y = blocked_x[steps:] == blocked_x[:-steps], blocked_y[:, steps:] == blocked_y[:, :-steps]
        whole &= along_x[:, :-steps] & along_x[:, steps:] & along_y[:-steps] & along_y[steps:]
        squares = [Square(float(x), float(y), steps * _GRID_IN) for x, y in grid[:-steps, :-steps][whole]]
        for square in sorted(squares, key=lambda square: min(dist(corner, near) for corner in square.corners)):
            if is_clear(square, world, radius_in):
                return square
    raise NoSquareError(
        f"{world.name} has no space for a square of {MIN_SIDE_IN:g} in that keeps {MARGIN_IN:g} in from all walls: "
        "calibrate in a larger room"
    )


def _count_blocked(grid: Floats, clearances: Floats, world: World, space_in: float) -> Counts:
    """Count the lines between neighbours along the first axis of a grid that are too near to a wall.

    Parameters
    ----------
    grid : (n, m, 2)
        Points, inches.
    clearances : (n, m)
        Their distances to the nearest wall, inches.
    world : World
    space_in : float
        Space that a line needs, inches.

    Returns
    -------
    (n, m)
        Number of such lines between a point and the first one in its column. A side is free if it is equal at its ends.
    """
    # 1. No point of a line is farther than half of it from one of its ends, which decides for most lines.
    nearer = np.minimum(clearances[:-1], clearances[1:])
    free = nearer >= space_in + _GRID_IN / 2
    # 2. Measure the others, in parts: the distances of all lines from all walls would take much memory.
    unsure = ~free & (nearer >= space_in - _ROUNDING_IN)
    lines = np.concatenate((grid[:-1][unsure], grid[1:][unsure]), axis=1)
    parts = np.split(lines, range(_PART, len(lines), _PART))
    distances = np.concatenate([segment_clearances(part, world.walls) for part in parts])
    free[unsure] = distances >= space_in - _ROUNDING_IN
    return np.concatenate((np.zeros((1, grid.shape[1]), dtype=int), np.cumsum(~free, axis=0)))


def is_clear(square: Square, world: World, radius_in: float) -> bool:
    """Return True if a robot of this radius can drive the sides with MARGIN_IN of space."""
    space_in = radius_in + MARGIN_IN
    free = all(world.clearance(*corner) >= space_in for corner in square.corners)
    return free and bool((segment_clearances(polygon_segments(square.corners), world.walls) >= space_in).all())


def tasks(square: Square, near: tuple[float, float], laps: int, spins: int) -> list[Task]:
    """Return the tasks of `laps` laps in each direction from the nearest corner, `spins` full turns at each corner."""
    corners = list(square.corners)
    first = min(range(len(corners)), key=lambda number: dist(corners[number], near))
    # Each side begins with a turn in place: full turns at the corners measure the turn scale.
    found: list[Task] = [DriveTo(*corners[first])]
    for direction in (1, -1):
        for side in range(len(corners) * laps):
            found += [Spin(direction * tau * spins)] if spins else []
            found.append(DriveTo(*corners[(first + direction * (side + 1)) % len(corners)]))
    return found


def path_to(goal: tuple[float, float], start: tuple[float, float], world: World, radius_in: float) -> list[DriveTo]:
    """Return the shortest path to a point with the largest possible margin. Raises NoPathError."""
    *wide, narrow_in = PATH_MARGINS_IN
    for margin_in in wide:
        with suppress(NoPathError):
            return _path(goal, start, world, radius_in + margin_in)
    return _path(goal, start, world, radius_in + narrow_in)


def _path(goal: tuple[float, float], start: tuple[float, float], world: World, space_in: float) -> list[DriveTo]:
    return [DriveTo(*point) for point in sample_waypoints(Roadmap(world.walls, space_in).path(start, goal))]


class Driver:
    """Controller from task to task; `more` is called for further tasks when all are done, until it returns none."""

    def __init__(self, tasks: Sequence[Task], speed_in_s: float, turn_rad_s: float,
                 more: Callable[[], Sequence[Task]] = tuple) -> None:
        self._tasks, self._more = list(tasks), more
        self._speed_in_s, self._turn_rad_s = speed_in_s, turn_rad_s
        self.passed = 0
        """Number of completed tasks."""
        self._aimed = False
        self._spin: TurnProgress | None = None

    @property
    def finished(self) -> bool:
        """True if all tasks are done."""
        return self.passed == len(self._tasks)

    @property
    def count(self) -> int:
        """Number of tasks so far."""
        return len(self._tasks)

    @property
    def goal(self) -> Floats | None:
        """Current goal (2,); None during turns in place and at the end."""
        task = None if self.finished else self._tasks[self.passed]
        return np.array(task) if isinstance(task, DriveTo) else None

    def command(self, pose: Floats) -> VelocityCommand | None:
        """Return the velocities at a pose (3,); None when all tasks are done."""
        # The first task that is not finished yet; finished ones return no command.
        while not self.finished:
            task = self._tasks[self.passed]
            command = self._turn(pose, task) if isinstance(task, Spin) else self._drive_to(pose, task)
            if command is not None:
                return command
            self.passed += 1
            self._aimed, self._spin = False, None
            if self.passed == self.count:
                self._tasks += self._more()
        return None

    def _turn(self, pose: Floats, task: Spin) -> VelocityCommand | None:
        heading_rad = float(pose[HEADING])
        self._spin = self._spin or TurnProgress(heading_rad, task.angle_rad)
        # Finished also if it turned too far: the sign of the remaining angle differs then.
        left = self._spin.remaining_rad(heading_rad)
        if left * task.angle_rad <= 0.0 or abs(left) < AIMED_RAD:
            return None
        return VelocityCommand(0.0, self._turn_rate(left))

    def _drive_to(self, pose: Floats, task: DriveTo) -> VelocityCommand | None:
        goal = np.array(task)
        away, off = float(distance_to(pose, goal)), float(bearing_error(pose, goal))
        # 1. Reached, or passed at a small distance: turning back would not make the result better.
        if away < REACHED_IN or (self._aimed and abs(off) > pi / 2 and away < 4.0 * REACHED_IN):
            return None
        # 2. Turn in place until aimed, with hysteresis: a small error while rolling does not stop the robot.
        self._aimed = abs(off) < (MAX_HEADING_ERROR_RAD if self._aimed else AIMED_RAD)
        if not self._aimed:
            return VelocityCommand(0.0, self._turn_rate(off))
        # 3. Roll, slower near the goal and off the bearing, and correct the heading.
        return VelocityCommand(min(self._speed_in_s, 0.5 + away) * max(cos(off), 0.0), self._turn_rate(off))

    def _turn_rate(self, off_rad: float) -> float:
        """Return a turning rate that decays with the remaining angle."""
        return float(np.clip(2.0 * off_rad, -self._turn_rad_s, self._turn_rad_s))


class LapPolicy:
    """Laps after the first: more until `is_enough()`, at most `maximum` including the first.

    `lap` contains the tasks of one lap in each direction.
    """

    def __init__(self, lap: Sequence[Task], maximum: int, is_enough: Callable[[], bool]) -> None:
        self._lap, self._maximum, self._is_enough = lap, maximum, is_enough
        self.begun = 1

    def more(self) -> Sequence[Task]:
        """Return the tasks of another lap, or none if that is enough."""
        if self.begun >= self._maximum or self._is_enough():
            return ()
        self.begun += 1
        return self._lap


TYPICAL_SCALE, TYPICAL_DRIFT, TYPICAL_RING, TYPICAL_SONAR = 0.03, 0.00075, radians(3.0), 1.0
"""Typical systematic errors: wheels 3 %, 0.75 mrad/in, ring 3 degrees, sonar 1 in."""
REQUIRED_PRECISION: Final = 1.0 / 30.0
"""Required standard deviation relative to the number: 10 % of it are then three standard deviations."""
NOISE_STDS: Final = 2.0
"""A number within this many standard deviations of 0 may be 0."""


class CalibrationNumber(NamedTuple):
    """One number of a calibration: its difference from an ideal robot, standard deviation, typical value."""

    name: str
    off: float
    std: float
    typical: float

    @property
    def is_enough(self) -> bool:
        """True if the number is accurate enough."""
        return self.std <= REQUIRED_PRECISION * max(abs(self.off), self.typical)

    @property
    def is_noise(self) -> bool:
        """True if the number may be 0."""
        return abs(self.off) <= NOISE_STDS * self.std

    @property
    def words(self) -> str:
        """Accuracy of the number relative to itself, as text."""
        return "within noise of zero" if self.is_noise else f"accurate to {self.std / abs(self.off):.1%}"


def numbers(found: Calibration) -> list[CalibrationNumber]:
    """Return all numbers of a calibration: distance, turn, drift, ring, and the sonars in order."""
    spread = found.spread
    sonars = enumerate(zip(found.offsets_in, spread.offsets_in, strict=True))
    return [
        CalibrationNumber("way", found.distance_scale - 1.0, spread.distance_scale, TYPICAL_SCALE),
        CalibrationNumber("turn", found.turn_scale - 1.0, spread.turn_scale, TYPICAL_SCALE),
        CalibrationNumber("drift", found.drift_rad_in, spread.drift_rad_in, TYPICAL_DRIFT),
        CalibrationNumber("ring", found.turned_rad, spread.turned_rad, TYPICAL_RING),
        *(CalibrationNumber(f"sonar {sonar}", off, std, TYPICAL_SONAR) for sonar, (off, std) in sonars),
    ]


def missing(found: Calibration) -> list[str]:
    """Return the names of numbers that are not accurate enough."""
    return [number.name for number in numbers(found) if not number.is_enough]


def noise_in(found: Calibration) -> list[str]:
    """Return the names of numbers that may be 0."""
    return [number.name for number in numbers(found) if number.is_noise]


def calibration_in(belief: Belief) -> Calibration:
    """Return the calibration in a belief over states of the calibrating filter, with its standard deviations."""
    mean, std, cov = belief.mean, belief.std, belief.cov
    # Each sonar has the common offset plus its own; their covariance counts.
    offsets = mean[OFFSET] + mean[OWN:]
    spread = np.sqrt(cov[OFFSET, OFFSET] + np.diagonal(cov)[OWN:] + 2.0 * cov[OFFSET, OWN:])
    return Calibration(
        1.0 + float(mean[OdometryParameter.DISTANCE_SCALE]),
        1.0 + float(mean[OdometryParameter.TURN_SCALE]),
        float(mean[OdometryParameter.DRIFT]),
        tuple(offsets.tolist()),
        float(mean[RING_TURN]),
        Spread(float(std[OdometryParameter.DISTANCE_SCALE]), float(std[OdometryParameter.TURN_SCALE]),
               float(std[OdometryParameter.DRIFT]), tuple(spread.tolist()), float(std[RING_TURN])),
    )


def table(found: Calibration) -> str:
    """Return a table of all numbers with their standard deviations and accuracies."""
    distance, turn, drift, ring, *sonars = numbers(found)
    rows = [
        ("distance, true / counted", 1.0 + distance.off, distance.std, 4, distance.words),
        ("turn, true / counted", 1.0 + turn.off, turn.std, 4, turn.words),
        ("drift, rad/in", drift.off, drift.std, 5, drift.words),
        ("ring turned, deg", degrees(ring.off), degrees(ring.std), 2, ring.words),
        *((f"sonar {k:>2} reads more, in", one.off, one.std, 2, one.words) for k, one in enumerate(sonars)),
    ]
    lines = [f"{name:24}{value:12.{places}f}{std:12.{places}f}   {words}" for name, value, std, places, words in rows]
    return "\n".join([f"{'':24}{'found':>12}{'± std':>12}", *lines])


START_STD = (0.5, 0.5, 0.02)
"""Default uncertainty of the initial pose: inches, inches, radians."""
# Seconds of the robot's clock between two lines of progress.
PRINT_INTERVAL_S = 10.0
# Laps without --laps, and the limit of --laps and --spins.
MAX_LAPS, MAX_COUNT = 8, 100
# Default speeds of straight lines and of turns, in/s and deg/s.
SPEED_IN_S, TURN_DEG_S = 10.0, 40.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad calibrate`."""
    add_address(parser)
    arguments.add_map_option(parser)
    add_value(parser, "--out", "FILE", Path,
              "write a model file (model_file= of nserver and sim:, --calibration of nomad localize)")
    add_value(parser, "--start", "X,Y,HEADING", arguments.parse_pose,
              "initial pose, inches and degrees (default: that of the encoders)")
    add_value(parser, "--start-std", "X,Y,HEADING", arguments.parse_pose_std,
              "standard deviation of the initial pose, inches and degrees (default: 0.5,0.5,1.15)", START_STD)
    arguments.add_robot_model_options(parser)
    add_value(parser, "--square", "X,Y,SIDE", _square,
              "drive this square: lower left corner and side in inches (default: the largest that fits)")
    add_value(parser, "--laps", "N", whole_number("the number of laps", 1, MAX_COUNT),
              "laps in each direction (default: until every number is known to a thirtieth of itself or of its "
              f"typical value, at most {MAX_LAPS})")
    add_value(parser, "--spins", "N", whole_number("the number of turns", 0, MAX_COUNT),
              "full turns in place at each corner, for the turn scale", 1)
    add_value(parser, "--speed", "IN_S", arguments.parse_positive, "speed in inches per second", SPEED_IN_S)
    add_value(parser, "--turn-speed", "DEG_S", arguments.parse_positive, "speed of turns in degrees per second",
              TURN_DEG_S)
    add_value(parser, "--time-limit", "S", arguments.parse_positive,
              "give up after this many seconds of the robot's clock", 3600.0)
    add_flag(parser, "--json", "print only the result, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    0: done; 3: given up; 4: the readings do not fit the sonar model, and nothing is written.
    """
    # 1. Everything that can fail without a robot.
    world = arguments.resolve_world(options)
    arguments.check_writable(options.out)
    robot, simulated = arguments.open_robot(options.address)
    # 2. Drive.
    with robot:
        options.body = resolve_robot_model(options.body, robot.model.name, options.address)
        body, state = resolve_body(options.body, options.model_file, options.address), robot.refresh()
        start = options.start or (state.x_in, state.y_in, state.steering_rad)
        belief = independent(np.array(start), options.start_std)
        fit = Consistency(arguments.find_sonar_model(robot, simulated, belief, world, body, options).rays)
        made = _drive(robot, world, options, fit)
    if isinstance(made, str):
        print(f"given up {made}\n{fit.line()}", file=sys.stderr if options.json else sys.stdout)
        return ExitCode.NOT_REACHED
    # 3. Results.
    found, laps = made
    if not options.json:
        print(f"{table(found)}\n{_describe_fit(found, fit, laps)}")
    if not fit.is_good:
        if options.json:
            print(fit.line(), file=sys.stderr)
        return ExitCode.UNFIT
    if options.json:
        quality = {"nis": fit.nis, "refused_share": fit.refused_fraction, "laps": laps}
        judgement = {"known_too_little": missing(found), "within_noise_of_zero": noise_in(found)}
        print(json.dumps({**calibration_as_json(found), **quality, **judgement}), flush=True)
    if options.out:
        comment = f"nomad calibrate, in {world.name}: {laps} laps in each direction, {options.spins} turns per corner"
        arguments.write_text(options.out, format_calibration(options.body, found, comment))
    return 0


def _drive(robot: Robot, world: World, options: argparse.Namespace, fit: Consistency) -> tuple[Calibration, int] | str:
    """Return the calibration and the number of laps in each direction, or why the run was given up."""
    # 1. Initial pose, models and filter.
    state = robot.refresh()
    start = options.start or (state.x_in, state.y_in, state.steering_rad)
    body = resolve_body(options.body, options.model_file, options.address)
    config = LocalizationConfig(world.walls, body, options.odometry_noise, sonar_of(body.ring, rays=fit.rays))
    method = CalibratingFilter(config, independent(np.array(start), options.start_std))
    # 2. Square, path to it and laps; without --laps more are driven until the result is accurate.
    square = _square_of(world, body.radius_in, start, options)
    first_tasks, corner = _tasks(world, body.radius_in, start, square, options)
    extra_lap = tasks(square, (corner.x_in, corner.y_in), 1, options.spins)[1:]
    max_laps = 1 if options.laps is not None else MAX_LAPS
    laps = LapPolicy(extra_lap, max_laps, lambda: not (fit.is_good and missing(calibration_in(method.belief))))
    # 3. Drive; give up after the time limit or when the robot does not move.
    driver = Driver(first_tasks, options.speed, radians(options.turn_speed), laps.more)
    stall_detector, printed_s = StallDetector(options.speed), state.clock_s or 0.0
    began_s = printed_s
    localizer = start_localizer(robot, config, method.belief, method)
    has_turret = robot.model.has_turret
    for progress in follow_waypoints(robot, localizer, driver, robot.sleep, turns_turret=has_turret):
        clock_s = progress.estimate.clock_s
        fit.add(progress.estimate.echoes)
        if clock_s - began_s > options.time_limit:
            return f"after {options.time_limit:g} s: use fewer --laps or --spins, or a longer --time-limit"
        stalled = stall_detector.reason(clock_s, progress.state, progress.estimate.pose, driver.goal)
        if stalled:
            return f"after {clock_s - began_s:.0f} s: {stalled}; check --start and the map"
        if not options.json and clock_s >= printed_s + PRINT_INTERVAL_S:
            printed_s = clock_s
            print(_line(clock_s - began_s, driver, calibration_in(method.belief)), flush=True)
    return calibration_in(method.belief), laps.begun if options.laps is None else options.laps


def _square_of(world: World, radius_in: float, start: tuple[float, ...], options: argparse.Namespace) -> Square:
    """Return the square of --square, or the largest that fits. Raises NoSquareError."""
    square: Square = options.square or largest_square(world, radius_in, (start[0], start[1]))
    if not is_clear(square, world, radius_in):
        raise NoSquareError(f"the square {tuple(square)} comes too near to walls: choose another, or omit --square")
    return square


def _tasks(world: World, radius_in: float, start: tuple[float, ...], square: Square,
           options: argparse.Namespace) -> tuple[list[Task], DriveTo]:
    """Return the path to the square and the first laps, and the corner where these begin and end.

    Raises NoPathError if the square cannot be reached.
    """
    here = (start[0], start[1])
    # The first task is the drive to the nearest corner; it is replaced by a path around obstacles.
    corner, *rest = tasks(square, here, 1 if options.laps is None else options.laps, options.spins)
    assert isinstance(corner, DriveTo)
    return [*path_to((corner.x_in, corner.y_in), here, world, radius_in), *rest], corner


def _describe_fit(found: Calibration, fit: Consistency, laps: int) -> str:
    """Return how well the calibration fits and what is not known well enough, as text."""
    # Parameters that are not known well enough yet.
    short = missing(found)
    if not short or not fit.is_good:
        return fit.line()
    return (f"after {laps} laps in each direction still inaccurate: {', '.join(short)}; use more --laps or a larger "
            f"room\n{fit.line()}")


def _line(passed_s: float, driver: Driver, found: Calibration) -> str:
    # Estimates with standard deviations; scales have no unit.
    spread = found.spread
    return (
        f"{passed_s:6.0f} s  {driver.passed:3d} of {driver.count} done  "
        f"distance {found.distance_scale:.4f} ± {spread.distance_scale:.4f}  "
        f"turn {found.turn_scale:.4f} ± {spread.turn_scale:.4f}  "
        f"drift {found.drift_rad_in:+.5f} ± {spread.drift_rad_in:.5f} rad/in"
    )


def _square(text: str) -> Square:
    x, y, side = arguments.parse_numbers(text, 3)
    if side <= 0:
        raise argparse.ArgumentTypeError("expected a side longer than 0")
    return Square(x, y, side)
