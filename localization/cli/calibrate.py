"""Drive a square, estimate the systematic errors of wheels and sonars, write a model file.

    nomad calibrate nserver://localhost:7019/1 --map thesis_room --out mine.toml
    nomad calibrate "sim:thesis_room?setup=worn&seed=1" --out worn.toml --laps 2

The robot drives the square (UMBmark) in both directions and turns in place at its corners, while a filter estimates the
errors from the walls. Exit code 0: done; 3: given up; 4: the readings do not fit the sonar model, nothing is written.
"""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from localization.cli import arguments
from localization.filters.base import LocalizationConfig, sonar_of
from localization.filters.belief import independent
from localization.filters.calibration import CalibratingFilter
from localization.live.assumptions import resolve_body, resolve_robot_model
from localization.live.localizer import Consistency
from localization.navigation import umbmark
from localization.navigation.recovery import StallDetector
from localization.navigation.waypoints import follow_waypoints, start_localizer
from nclient import Robot
from nclient.common.arguments import add_address, add_flag, add_value, whole_number
from nclient.common.files import write_errors_as
from nclient.common.process import ExitCode
from nclient.errors import OutputFileError
from worlds.robots import Calibration, calibration_as_json, format_calibration
from worlds.world import World

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
        print(f"{umbmark.table(found)}\n{_describe_fit(found, fit, laps)}")
    if not fit.is_good:
        if options.json:
            print(fit.line(), file=sys.stderr)
        return ExitCode.UNFIT
    if options.json:
        quality = {"nis": fit.nis, "refused_share": fit.refused_fraction, "laps": laps}
        judgement = {"known_too_little": umbmark.missing(found), "within_noise_of_zero": umbmark.noise_in(found)}
        print(json.dumps({**calibration_as_json(found), **quality, **judgement}), flush=True)
    if options.out:
        comment = f"nomad calibrate, in {world.name}: {laps} laps in each direction, {options.spins} turns per corner"
        with write_errors_as(OutputFileError, options.out):
            options.out.write_text(format_calibration(options.body, found, comment), encoding="utf-8")
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
    first = _tasks(world, body.radius_in, start, square, options)
    extra_lap = umbmark.tasks(square, (first.corner.x_in, first.corner.y_in), 1, options.spins)[1:]
    max_laps = 1 if options.laps is not None else MAX_LAPS
    laps = umbmark.LapPolicy(
        extra_lap, max_laps, lambda: not (fit.is_good and umbmark.missing(umbmark.calibration_in(method.belief)))
    )
    # 3. Drive; give up after the time limit or when the robot does not move.
    driver = umbmark.Driver(first.tasks, options.speed, math.radians(options.turn_speed), laps.more)
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
            print(_line(clock_s - began_s, driver, umbmark.calibration_in(method.belief)), flush=True)
    return umbmark.calibration_in(method.belief), laps.begun if options.laps is None else options.laps


class _Route(NamedTuple):
    """The path to the square and the first laps; the corner where the laps begin and end."""

    tasks: list[umbmark.Task]
    corner: umbmark.DriveTo


def _square_of(
    world: World, radius_in: float, start: tuple[float, ...], options: argparse.Namespace
) -> umbmark.Square:
    """Return the square of --square, or the largest that fits. Raises NoSquareError."""
    square: umbmark.Square = options.square or umbmark.largest_square(world, radius_in, (start[0], start[1]))
    if not umbmark.is_clear(square, world, radius_in):
        reason = f"the square {tuple(square)} comes too near to walls: choose another, or omit --square"
        raise umbmark.NoSquareError(reason)
    return square


def _tasks(
    world: World, radius_in: float, start: tuple[float, ...], square: umbmark.Square, options: argparse.Namespace
) -> _Route:
    """Return the route to the square and around it. Raises NoPathError if the square cannot be reached."""
    here = (start[0], start[1])
    # The first task is the drive to the nearest corner; it is replaced by a path around obstacles.
    corner, *rest = umbmark.tasks(square, here, 1 if options.laps is None else options.laps, options.spins)
    assert isinstance(corner, umbmark.DriveTo)
    return _Route([*umbmark.path_to((corner.x_in, corner.y_in), here, world, radius_in), *rest], corner)


def _describe_fit(found: Calibration, fit: Consistency, laps: int) -> str:
    """Return how well the calibration fits and what is not known well enough, as text."""
    # Parameters that are not known well enough yet.
    short = umbmark.missing(found)
    if not short or not fit.is_good:
        return fit.line()
    text = f"after {laps} laps in each direction still inaccurate: {', '.join(short)}; "
    text += "use more --laps or a larger room"
    return f"{text}\n{fit.line()}"


def _line(passed_s: float, driver: umbmark.Driver, found: Calibration) -> str:
    # Estimates with standard deviations; scales have no unit.
    spread = found.spread
    return (
        f"{passed_s:6.0f} s  {driver.passed:3d} of {driver.count} done  "
        f"distance {found.distance_scale:.4f} ± {spread.distance_scale:.4f}  "
        f"turn {found.turn_scale:.4f} ± {spread.turn_scale:.4f}  "
        f"drift {found.drift_rad_in:+.5f} ± {spread.drift_rad_in:.5f} rad/in"
    )


def _square(text: str) -> umbmark.Square:
    x, y, side = arguments.parse_numbers(text, 3)
    if side <= 0:
        raise argparse.ArgumentTypeError("expected a side longer than 0")
    return umbmark.Square(x, y, side)
