"""Drive a square both ways round, find out what wheels and sonars get wrong, write a model file.

Rules: reads options, prints, waits on the real clock; square drives, filters.calibrating estimates.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from localization.calibration.procedure import (
    Driver,
    Go,
    NoSquareError,
    Rounds,
    Square,
    Task,
    is_clear,
    largest_square,
    tasks,
    way_to,
)
from localization.calibration.procedure import run as guided
from localization.calibration.result import calibration_in, missing, noise_in, table
from localization.cli.options import add_robot_model_options, check_writable, numbers, open_robot, pose, positive, stds
from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.calibration import CalibratingFilter
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR
from localization.live.assumptions import add_map_option, resolve_robot_model, resolve_world, taken
from localization.live.localizer import Consistency
from localization.navigation.recovery import StallDetector
from nclient import Robot
from nclient.common.exit_codes import ExitCode
from nclient.common.files import describe_write_error
from nclient.errors import OutputFileError
from worlds.robots import BODIES, Calibration, format_calibration
from worlds.world import World

START_STD = (0.5, 0.5, 0.02)
"""How well the robot is placed at the start: inches, inches, radians."""
TOLD_EVERY_S = 10.0
MOST_LAPS, MOST_COUNT = 8, 100
SPEED_IN_S, TURN_DEG_S = 10.0, 40.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `nomad calibrate`."""
    parser.description = (
        "Find out what a robot's wheels and sonars get wrong every time: drive a square (UMBmark's) both ways round, "
        "turning on the spot at its corners, with a filter on that knows the walls; then write a model file."
    )
    parser.epilog = "example: nomad calibrate nserver://localhost:7019/1 --map thesis_room --out mine.toml"
    parser.add_argument(
        "address", nargs="?", metavar="ADDRESS", help="of the robot (default: NOMAD_ROBOT, or a local nserver)"
    )
    add_map_option(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write a model file (model_file= of nserver and sim:, --calibration of nomad localize)",
    )
    parser.add_argument(
        "--start",
        type=pose,
        metavar="X,Y,HEADING",
        help="where the robot stands now, inches and degrees (default: what its encoders say)",
    )
    parser.add_argument(
        "--start-std",
        type=stds,
        default=START_STD,
        metavar="X,Y,HEADING",
        help="how well that is known, inches and degrees (default 0.5,0.5,1.15)",
    )
    add_robot_model_options(parser)
    parser.add_argument(
        "--square",
        type=_square,
        metavar="X,Y,SIDE",
        help="the square: lower left corner and side in inches (default: the largest with room)",
    )
    parser.add_argument(
        "--laps",
        type=partial(_count, least=1),
        metavar="N",
        help="laps each way (default: until all is known to a thirtieth of itself, or of what is "
        f"typical, but {MOST_LAPS} at most)",
    )
    parser.add_argument(
        "--spins",
        type=_count,
        default=1,
        metavar="N",
        help="full turns on the spot at each corner, for the turn's scale (default %(default)s)",
    )
    parser.add_argument(
        "--speed", type=positive, default=SPEED_IN_S, metavar="IN_S", help="speed in in/s (default %(default)s)"
    )
    parser.add_argument(
        "--turn-speed",
        type=positive,
        default=TURN_DEG_S,
        metavar="DEG_S",
        help="speed of turns in deg/s (default %(default)s)",
    )
    parser.add_argument(
        "--time-limit",
        type=positive,
        default=3600.0,
        metavar="S",
        help="give up after so many seconds of the robot's clock (default %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON, alone on stdout")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Do it. 0 when all went well, 3 when it was given up, 4 where readings do not fit: then nothing is written."""
    world = resolve_world(options)
    check_writable(options.out)
    robot, simulated = open_robot(options.address)
    sonars = taken(options.sonars, simulated, options.address)
    fit = Consistency(sonars.rays)
    if sonars.line():
        print(sonars.line(), file=sys.stderr if options.json else sys.stdout, flush=True)
    with robot:
        options.body = resolve_robot_model(options.body, robot.model.name, options.address)
        made = _drive(robot, world, options, fit)
    if isinstance(made, str):
        print(f"given up {made}\n{fit.line()}", file=sys.stderr if options.json else sys.stdout)
        return ExitCode.NOT_REACHED
    found, laps = made
    if not options.json:
        print(f"{table(found)}\n{_verdict(found, fit, laps)}")
    if not fit.is_good:
        if options.json:
            print(fit.line(), file=sys.stderr)
        return ExitCode.UNFIT
    if options.json:
        print(json.dumps({**asdict(found), "nis": fit.nis, "refused_share": fit.refused_fraction, "laps": laps,
                          "known_too_little": missing(found), "within_noise_of_zero": noise_in(found)}),
              flush=True)  # fmt: skip
    if options.out:
        said = f"nomad calibrate, in {world.name}: {laps} laps each way, {options.spins} turns a corner"
        _write(options.out, format_calibration(options.body, found, said))
    return 0


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputFileError(describe_write_error(path, error)) from error


def _drive(robot: Robot, world: World, options: argparse.Namespace, fit: Consistency) -> tuple[Calibration, int] | str:
    """What was found, and in how many laps each way; why not, where it was given up."""
    state = robot.refresh()
    start = options.start or (state.x_in, state.y_in, state.steering_rad)
    body = BODIES[options.body]
    known = LocalizationConfig(world.walls, body, options.odometry_noise, WIRE_SONAR if fit.rays else ConeSonar())
    method = CalibratingFilter(known, independent(np.array(start), options.start_std))
    square = _square_of(world, body.radius_in, start, options)
    first = _tasks(world, body.radius_in, start, square, options)
    again = tasks(square, (first.corner.x_in, first.corner.y_in), 1, options.spins)[1:]
    rounds = Rounds(again, 1 if options.laps is not None else MOST_LAPS,
                    lambda: not (fit.is_good and missing(calibration_in(method.belief))))  # fmt: skip
    driver = Driver(first.tasks, options.speed, math.radians(options.turn_speed), rounds.more)
    obstruction, told_s = StallDetector(options.speed), state.clock_s or 0.0
    began_s = told_s
    for progress in guided(robot, known, method, driver, time.sleep):
        clock_s = progress.estimate.clock_s
        fit.add(progress.estimate.echoes)
        if clock_s - began_s > options.time_limit:
            return f"after {options.time_limit:g} s: fewer --laps or --spins, or a longer --time-limit"
        obstructed = obstruction.reason(clock_s, progress.state, progress.estimate.pose, driver.goal)
        if obstructed:
            return f"{clock_s - began_s:.0f} s on, {obstructed}; is --start right, and the map?"
        if not options.json and clock_s >= told_s + TOLD_EVERY_S:
            told_s = clock_s
            print(_line(clock_s - began_s, driver, calibration_in(method.belief)), flush=True)
    return calibration_in(method.belief), rounds.begun if options.laps is None else options.laps


class _First(NamedTuple):
    """The way to the square and the first laps; the corner where those begin and end."""

    tasks: list[Task]
    corner: Go


def _square_of(world: World, radius_in: float, start: tuple[float, ...], options: argparse.Namespace) -> Square:
    """The one asked for, or the largest. Raises NoSquareError."""
    square: Square = options.square or largest_square(world, radius_in, (start[0], start[1]))
    if not is_clear(square, world, radius_in):
        raise NoSquareError(f"the square {tuple(square)} comes too near to walls: choose another, or leave it out")
    return square


def _tasks(
    world: World, radius_in: float, start: tuple[float, ...], square: Square, options: argparse.Namespace
) -> _First:
    """To the square, and round it. Raises NoPathError where there is no way to it."""
    here = (start[0], start[1])
    corner, *rest = tasks(square, here, 1 if options.laps is None else options.laps, options.spins)
    assert isinstance(corner, Go)
    return _First([*way_to((corner.x_in, corner.y_in), here, world, radius_in), *rest], corner)


def _verdict(found: Calibration, fit: Consistency, laps: int) -> str:
    """How far it is to be believed, in words."""
    short = missing(found)
    if not short or not fit.is_good:
        return fit.line()
    told = f"after {laps} laps each way: {', '.join(short)} could be known better: more --laps, or a larger room"
    return f"{told}\n{fit.line()}"


def _line(passed_s: float, driver: Driver, found: Calibration) -> str:
    spread = found.spread
    return (
        f"{passed_s:6.0f} s  {driver.done:3d} of {driver.count} done  "
        f"way {found.way_scale:.4f} ± {spread.way_scale:.4f}  "
        f"turn {found.turn_scale:.4f} ± {spread.turn_scale:.4f}  "
        f"drift {found.drift_rad_in:+.5f} ± {spread.drift_rad_in:.5f} rad/in"
    )


def _square(text: str) -> Square:
    x, y, side = numbers(text, 3)
    if side <= 0:
        raise argparse.ArgumentTypeError("a side is longer than 0")
    return Square(x, y, side)


def _count(text: str, least: int = 0) -> int:
    if not text.isdecimal() or not least <= int(text) <= MOST_COUNT:
        raise argparse.ArgumentTypeError(f"a whole number from {least} to {MOST_COUNT}, not {text!r}")
    return int(text)
