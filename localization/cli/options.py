"""What commands that drive a robot read from their command line: numbers, places, the robot of an address.

Rules: readers for argparse, which says what it wanted; shared by the commands, none of which is known here.

The options by which one run goes on from another: --save, --resume, --moved-std.

Rules: reads options and hands on; what still holds is kept.py's to say, the file is kept_file.py's.

What every command that localizes a robot begins with: its options, and from them the first belief.

    add_known()      what is known of the robot, for whoever hears its sonars
    add_options()    the same, and how it is to be localized
    outset()         where the robot is said to stand, what its sonars are taken for, what is believed of it

Rules: reads options, says on stdout (stderr with --json) what is guessed; what is driven is the command's.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import POSE, Belief, independent
from localization.filters.health import HealthStatus
from localization.filters.odometry import MAX_STATE, OdometryNoise, with_parameters
from localization.filters.registry import METHODS
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR
from localization.live import saved_estimate
from localization.live.assumptions import Taken, taken
from localization.live.localizer import Estimate
from localization.live.run import Run
from localization.live.saved_estimate import Kept, Moved, map_signature, resume_belief
from localization.live.sensor_input import EncoderPose, with_wheels
from localization.navigation.waypoints import Speeds
from nclient import ReplyTimeout, Robot, RobotState, connect
from nclient.common.files import describe_write_error
from nclient.errors import EstimateFileError, OutputFileError
from worlds.robots import BODIES, IDEAL_CALIBRATION, Calibration, load_calibration
from worlds.world import World

MOST_NOISE: Final = 10
"""More noise than this is a slip of the keyboard."""
UNKNOWN: Final = "unknown"


def open_robot(address: str | None) -> tuple[Robot, bool]:
    """The robot, and whether it can be asked for the truth: an Nserver of old leaves unknown messages unanswered."""
    robot = connect(address)
    try:
        return robot, robot.is_simulated()
    except ReplyTimeout:
        return connect(address), False


def make_folder(folder: Path) -> None:
    """Before anything is run: the folder for what comes of it. Raises OutputFileError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputFileError(describe_write_error(folder, error)) from error


def check_writable(*files: Path | None) -> None:
    """Before anything is driven: whether files can be written at its end, in folders that are made where they are not
    there. Raises OutputFileError."""
    for file in filter(None, files):
        make_folder(file.parent)
        real = Path(os.path.realpath(file))
        if real.is_dir() or not os.access(real if real.exists() else real.parent, os.W_OK):
            raise OutputFileError(
                f"{str(file)!r}: cannot be written there: name a file in a folder that may be written to"
            )


def numbers(text: str, count: int, told: str = "") -> list[float]:
    """So many finite numbers with commas between them; `told`: of what they are, where that is not plain."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        wanted = "a number" if count == 1 else f"{count} numbers with commas between them"
        raise argparse.ArgumentTypeError(f"{wanted}{told}, not {text!r}")
    return numbers


def point(text: str) -> tuple[float, float]:
    """A place, inches."""
    x, y = numbers(text, 2, ", inches, such as 20,40")
    return x, y


def pose(text: str, told: str = "") -> tuple[float, float, float]:
    """A place in inches, and a direction in degrees that becomes radians."""
    x, y, heading_deg = numbers(text, 3, f", inches, inches and degrees{told}")
    return x, y, math.radians(heading_deg)


def start(text: str) -> tuple[float, float, float] | str:
    """A pose, or UNKNOWN."""
    return UNKNOWN if text.strip().lower() == UNKNOWN else pose(text, f", or {UNKNOWN}")


def stds(text: str) -> tuple[float, float, float]:
    """Standard deviations of a pose, likewise."""
    x, y, heading_rad = pose(text)
    if min(x, y, heading_rad) < 0:
        raise argparse.ArgumentTypeError("a standard deviation is not negative")
    return x, y, heading_rad


def noise(text: str) -> OdometryNoise:
    """Three standard deviations of the odometry's noise."""
    found = numbers(text, 3)
    if not all(0 <= number <= MOST_NOISE for number in found):
        raise argparse.ArgumentTypeError(f"three numbers from 0 to {MOST_NOISE}, not {text!r}")
    return OdometryNoise(*found)


def constants(text: str) -> tuple[float, ...]:
    """Standard deviations of the encoders' own errors."""
    stds = tuple(numbers(text, text.count(",") + 1))
    if len(stds) > MAX_STATE - POSE or min(stds) < 0:
        raise argparse.ArgumentTypeError(f"one to {MAX_STATE - POSE} numbers of 0 or more, not {text!r}")
    return stds


def seconds(text: str) -> float:
    """A time of 0 s or more."""
    (number,) = numbers(text, 1)
    if number < 0:
        raise argparse.ArgumentTypeError("seconds are 0 or more")
    return number


def positive(text: str) -> float:
    """A number above 0."""
    (number,) = numbers(text, 1)
    if number <= 0:
        raise argparse.ArgumentTypeError("a number above 0")
    return number


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The three options."""
    parser.add_argument("--save", type=Path, metavar="FILE", help="write down at the end what is believed of the pose")
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="FILE",
        help="go on from what --save wrote, of the same robot on the same map; refused where the "
        "encoders were set or the robot was switched off meanwhile",
    )
    parser.add_argument("--moved-std", type=_moved, metavar="X,Y,HEADING",
                        help="with --resume: how far the robot may have been moved meanwhile without its encoders' "
                             "telling, inches and degrees (0,0,0: it stood)")  # fmt: skip


def resumed_belief(options: argparse.Namespace, world: World, state: RobotState) -> Belief | None:
    """What is believed at the first state of a run that goes on; None where it begins anew.

    Raises EstimateFileError.
    """
    if options.resume is None:
        if options.moved_std is not None:
            raise EstimateFileError("--moved-std says more of --resume FILE, which is not given")
        return None
    if options.start:
        raise EstimateFileError("--start begins anew and --resume goes on: give one of them")
    old = saved_estimate.load(options.resume)
    pose = np.array([state.x_in, state.y_in, state.steering_rad])
    now = EncoderPose.of(state.clock_s or 0.0, pose, state.turret_rad)
    held = resume_belief(old, map_signature(world, options.body), now, options.odometry_noise, options.moved_std)
    known = len(held.mean) - POSE
    return with_parameters(held, options.scale_std[known:])


def save(options: argparse.Namespace, world: World, done: Run) -> None:
    """Write the end of a run down where that is asked for: pose and wheels, not what a method knows besides.

    Raises EstimateFileError, for a lost estimate too.
    """
    last = done.moments[-1]
    keep(options, world, last.estimate, last.odometry, last.turret_rad)


def keep(
    options: argparse.Namespace, world: World, estimate: Estimate, odometry: tuple[float, float, float],
    turret_rad: float,
) -> None:  # fmt: skip
    """Write an estimate down, and what the encoders say with it; as `save`."""
    if options.save is None:
        return
    if estimate.health.status is HealthStatus.LOST:
        raise EstimateFileError(f"{options.save}: not written, the estimate is lost: {estimate.health.reason}")
    encoders = EncoderPose.of(estimate.clock_s, np.array(odometry), turret_rad)
    known = Belief(estimate.belief.mean[:MAX_STATE], estimate.belief.cov[:MAX_STATE, :MAX_STATE])
    saved_estimate.save(options.save, Kept(map_signature(world, options.body), encoders, known))


def _moved(text: str) -> Moved:
    try:
        x, y, heading_deg = (float(part) for part in text.split(","))
    except ValueError:
        x = y = heading_deg = math.nan
    if not all(0.0 <= number < math.inf for number in (x, y, heading_deg)):
        raise argparse.ArgumentTypeError(f"three numbers of 0 or more with commas between them, not {text!r}")
    return x, y, math.radians(heading_deg)


START_STD = (0.1, 0.1, 0.01)
"""How well the robot is placed at the start: inches, inches, radians."""


class LocalizationSetup(NamedTuple):
    """What is believed at the first state, of a robot in surroundings, and for what its sonars are taken."""

    belief: Belief
    known: LocalizationConfig
    sonars: Taken


def add_robot_model_options(parser: argparse.ArgumentParser) -> None:
    """What is known of a robot: --body, --odometry-noise, --sonars."""
    parser.add_argument(
        "--body", choices=sorted(BODIES), help="the robot's model, where its address does not tell it (default n150)"
    )
    parser.add_argument(
        "--odometry-noise",
        type=noise,
        default=THESIS_ODOMETRY,
        metavar="A,B,C",
        help="stds of what the encoders miss by chance: in after 1 in, rad after 1 rad, rad after 1 in "
        f"(default {','.join(str(value) for value in astuple(THESIS_ODOMETRY))})",
    )
    parser.add_argument(
        "--sonars",
        choices=("rays", "cones"),
        help="how readings are understood: exact rays (setups ideal and noisy) or a real ring's cones, "
        "with bad readings among them (default: as the setup of a sim: address has them, rays of "
        "other simulations, cones of a robot)",
    )


def add_options(parser: argparse.ArgumentParser, method: str, method_help: str, publish_help: str) -> None:
    """What all these commands have; `method` is the one where none is given."""
    parser.add_argument(
        "--start-std",
        type=stds,
        default=START_STD,
        metavar="X,Y,HEADING",
        help="how well that is known, inches and degrees (default 0.1,0.1,0.57)",
    )
    parser.add_argument(
        "--speed",
        type=positive,
        default=Speeds().translation_in_s,
        metavar="IN_S",
        help="top speed in in/s (default %(default)s)",
    )
    add_robot_model_options(parser)
    parser.add_argument(
        "--scale-std",
        type=constants,
        default=(),
        metavar="A[,B[,C]]",
        help="find out the encoders' own errors, so uncertain at first: share of the way, share of the "
        "turn, drift in rad/in (default: none; 0.05 is a worn robot's)",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="what this robot's wheels and sonars get wrong: a model file as nomad calibrate writes; "
        "counts before --scale-std",
    )
    parser.add_argument("--method", choices=METHODS, default=method, help=f"{method_help} (default {method})")
    parser.add_argument(
        "--publish",
        metavar="URL",
        help="show estimate and echoes on the page of `nserver --viewer`, at the address that it "
        f"printed{publish_help}",
    )
    add_arguments(parser)


def prepare_localization(robot: Robot, simulated: bool, world: World, options: argparse.Namespace) -> LocalizationSetup:
    """Set the encoders where that is asked for, and say what is believed. Raises EstimateFileError, WorldFileError."""
    state = _placed(robot, robot.refresh(), options.start) if options.start else robot.refresh()
    errs = load_calibration(options.calibration, options.body) if options.calibration else IDEAL_CALIBRATION
    belief = resumed_belief(options, world, state) or _anew(options, state, errs)
    sonars = taken(options.sonars, simulated, options.address)
    if sonars.line():
        print(sonars.line(), file=sys.stderr if options.json else sys.stdout, flush=True)
    sonar = WIRE_SONAR if sonars.rays else ConeSonar()
    known = LocalizationConfig(world.walls, BODIES[options.body], options.odometry_noise, sonar, calibration=errs)
    return LocalizationSetup(belief, known, sonars)


def _placed(robot: Robot, state: RobotState, start: Sequence[float] | str) -> RobotState:
    """The state after the encoders are set to where the robot stands, its turret against its body as it was."""
    if start == UNKNOWN:
        return state
    x, y, heading = map(float, start)
    robot.set_position(x_in=x, y_in=y)
    return robot.set_angles(steering_rad=heading, turret_rad=heading + state.turret_rad - state.steering_rad)


def _anew(options: argparse.Namespace, state: RobotState, errs: Calibration) -> Belief:
    here = independent([state.x_in, state.y_in, state.steering_rad], options.start_std)
    return with_wheels(here, errs) if options.calibration else with_parameters(here, options.scale_std)
