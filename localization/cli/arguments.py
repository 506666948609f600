"""Options shared by the commands of localization, and what they configure: robot, map, initial belief."""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, Final

import numpy as np

from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig, sonar_of
from localization.filters.belief import POSE, Belief, Floats, difference, independent
from localization.filters.global_localization import is_wide
from localization.filters.odometry import MAX_STATE, OdometryNoise, with_parameters
from localization.filters.registry import DEFAULT_METHOD, FINDER, METHOD_CHOICES
from localization.filters.sonar_cone import building_sonar
from localization.live import assumptions
from localization.live import estimate as saved_estimate
from localization.live.assumptions import SIMULATION, decide_by_readings
from localization.live.run import Run
from localization.live.sensor_input import EncoderPose, Pose, restart_ring, with_wheels
from localization.mapping.aliases import AliasFinder
from localization.navigation.waypoints import Speeds
from nclient import ReplyTimeout, Robot, RobotState, connect
from nclient.common.arguments import ABOVE_ZERO, add_value, number
from nclient.common.files import write_errors_as
from nclient.connector import address_or_default
from nclient.errors import EstimateFileError, OutputFileError
from nclient.url import parse_address, split_address
from worlds.io import DEFAULT_WORLD, format_world, load_world, parse_world
from worlds.robots import BODIES, IDEAL_CALIBRATION, N150, Body, load_bodies, load_calibration
from worlds.world import World

MAX_NOISE: Final = 10
"""Larger odometry noise is a typing error."""
PUBLISH_VARIABLE: Final = "NOMAD_PUBLISH"
"""Environment variable with the page's address; a localizer that the page has started gets it from there."""
UNKNOWN: Final = "unknown"
"""Value of --start for a robot whose pose is not known."""
ENCODERS: Final = "encoders"
"""Source of a start that is neither given nor resumed."""
ROUND_MARGIN_S: Final = 0.1
"""Time after a round of the ring in which its last echo is reported."""
START_STD = (0.1, 0.1, 0.01)
"""Default uncertainty of the initial pose: inches, inches, radians."""


MAX_START_SIGMAS: Final = 3.0
"""A true start farther from a given one is in another frame."""


# readers of argparse


def parse_numbers(text: str, count: int, meaning: str = "") -> list[float]:
    """Return `count` finite numbers separated by commas; `meaning` describes them in the error message."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        expected = "a number" if count == 1 else f"{count} numbers separated by commas"
        raise argparse.ArgumentTypeError(f"expected {expected}{meaning}, not {text!r}")
    return numbers


def parse_point(text: str) -> tuple[float, float]:
    """Return a position x,y in inches."""
    x, y = parse_numbers(text, 2, ", inches, such as 20,40")
    return x, y


def parse_pose(text: str, alternative: str = "") -> tuple[float, float, float]:
    """Return a pose x,y,heading given in inches and degrees as inches and radians."""
    x, y, heading_deg = parse_numbers(text, 3, f", inches, inches and degrees{alternative}")
    return x, y, math.radians(heading_deg)


def parse_start(text: str) -> tuple[float, float, float] | str:
    """Return a pose, or UNKNOWN."""
    return UNKNOWN if text.strip().lower() == UNKNOWN else parse_pose(text, f", or {UNKNOWN}")


def parse_pose_std(text: str) -> tuple[float, float, float]:
    """Return standard deviations of a pose, given in inches and degrees."""
    x, y, heading_rad = parse_pose(text)
    if min(x, y, heading_rad) < 0:
        raise argparse.ArgumentTypeError("standard deviations must not be negative")
    return x, y, heading_rad


def parse_odometry_noise(text: str) -> OdometryNoise:
    """Return the three standard deviations of odometry noise."""
    numbers = parse_numbers(text, 3)
    if not all(0 <= number <= MAX_NOISE for number in numbers):
        raise argparse.ArgumentTypeError(f"expected three numbers from 0 to {MAX_NOISE}, not {text!r}")
    return OdometryNoise(*numbers)


def parse_scale_std(text: str) -> tuple[float, ...]:
    """Return the initial standard deviations of the odometry parameters, one to three."""
    stds = tuple(parse_numbers(text, text.count(",") + 1))
    if len(stds) > MAX_STATE - POSE or min(stds) < 0:
        raise argparse.ArgumentTypeError(f"expected one to {MAX_STATE - POSE} numbers of 0 or more, not {text!r}")
    return stds


def parse_scales(text: str) -> tuple[float, ...]:
    """Return standard deviations of the odometry parameters as `parse_scale_std` does, all above 0."""
    stds = parse_scale_std(text)
    if not all(0.0 < std < math.inf for std in stds):
        raise argparse.ArgumentTypeError(f"expected numbers above 0, not {text!r}")
    return stds


parse_seconds: Final = number("expected 0 s or more", 0.0)
parse_positive: Final = number("expected a number above 0", ABOVE_ZERO)


# options


def add_map_option(parser: argparse.ArgumentParser, other_source: str = "") -> None:
    """Add --map; `other_source` names where else the command may get its walls from, for the help."""
    parser.add_argument("--map", "--world", metavar="WORLD",
                        help="map of the walls: a shipped world or a TOML file "
                             f"(default: {other_source}the world of a sim: address)")  # fmt: skip
    parser.set_defaults(refuse=parser.error)


def add_robot_model_options(parser: argparse.ArgumentParser) -> None:
    """Add --body, --model-file, --odometry-noise and --sonars."""
    parser.add_argument("--body", type=str.lower, metavar=f"{{{','.join(sorted(BODIES))}}}",
                        help="robot model, if the address does not name it, or one of --model-file (default: n150)")
    parser.add_argument("--model-file", type=Path, metavar="FILE",
                        help="robot models that override or extend these (default: model_file of a sim: address)")
    add_odometry_noise(parser)
    parser.add_argument("--sonars", choices=("rays", "cones", assumptions.BUILDING_SETUP),
                        help="sonar model: exact rays (setups ideal and noisy), the cones of a real ring, including "
                             "outliers, or the same in a real building, whose walls have doors and posts (method "
                             "ekf; others: cones) (default: for sim: addresses that of the setup, rays for other "
                             "simulations, cones for robots)")  # fmt: skip


def add_odometry_noise(parser: argparse.ArgumentParser) -> None:
    """Add the option of the odometry's random errors."""
    add_value(parser, "--odometry-noise", "A,B,C", parse_odometry_noise,
              "standard deviations of the random odometry error: in after 1 in, rad after 1 rad, rad after 1 in "
              f"(default: {','.join(str(value) for value in astuple(THESIS_ODOMETRY))})", THESIS_ODOMETRY)


def add_localization_options(parser: argparse.ArgumentParser, method: str, method_help: str, publish_help: str) -> None:
    """Add the options of all commands that localize a robot; `method` is the default filter."""
    add_value(parser, "--start-std", "X,Y,HEADING", parse_pose_std,
              "standard deviation of the initial pose, inches and degrees (default: 0.1,0.1,0.57; of encoders of a "
              "robot that has driven: wider)")
    add_value(parser, "--speed", "IN_S", parse_positive, "top speed in inches per second", Speeds().translation_in_s)
    add_robot_model_options(parser)
    add_value(parser, "--scale-std", "A[,B[,C]]", parse_scale_std,
              "estimate systematic odometry errors with these initial standard deviations: distance "
              "scale, turn scale, drift in rad/in (default: none; 0.05 for a worn robot)", ())
    add_value(parser, "--calibration", "FILE", Path,
              "apply the calibration in this model file, as written by nomad calibrate; takes "
              "precedence over --scale-std")
    parser.add_argument("--method", choices=METHOD_CHOICES, default=method,
                        help=f"{method_help}; or a class of your own, module:Class or file.py:Class (default: "
                             f"{method})")  # fmt: skip
    add_publish(parser, "estimate and echoes", publish_help)
    add_resume_options(parser)


def add_publish(parser: argparse._ActionsContainer, shown: str, more: str = "") -> None:
    """Add --publish; `shown` is what the page shows."""
    parser.add_argument("--publish", metavar="URL", default=os.environ.get(PUBLISH_VARIABLE),
                        help=f"show {shown} on the page of `nserver --viewer`, at the address that it "
                             f"printed{more} (default: ${PUBLISH_VARIABLE})")  # fmt: skip


class _RenamedOption(argparse.Action):
    """An option under its old name: accepted for one version, with a warning that names the new one."""

    def __call__(self, _: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
                 option: str | None = None) -> None:
        print(f"nomad: {option} is now called --displacement-std; the old name will be removed", file=sys.stderr)
        setattr(namespace, self.dest, values)


def add_resume_options(parser: argparse.ArgumentParser) -> None:
    """Add --save, --resume and --displacement-std."""
    add_value(parser, "--save", "FILE", Path, "save the final estimate to FILE")
    add_value(parser, "--resume", "FILE", Path,
              "continue from an estimate written by --save, of the same robot on the same map; rejected "
              "if the encoders were set or the robot was switched off meanwhile")
    add_value(parser, "--displacement-std", "X,Y,HEADING", parse_pose_std,
              "with --resume: standard deviation of a displacement meanwhile that the encoders did not "
              "measure, inches and degrees (0,0,0: none)")
    parser.add_argument("--moved-std", dest="displacement_std", type=parse_pose_std, action=_RenamedOption,
                        metavar="X,Y,HEADING", help=argparse.SUPPRESS)  # fmt: skip


# files and the robot


def open_robot(address: str | None) -> tuple[Robot, bool]:
    """Connect to a robot; return it and True if it is simulated and reports ground truth."""
    robot = connect(address)
    try:
        return robot, robot.is_simulated()
    except ReplyTimeout:
        # The original Nserver does not reply to unknown messages; connect again for a clean exchange.
        return connect(address), False


def is_lockstep(address: str | None) -> bool:
    """Return True if the address is a simulation in this process, whose time waits for its client."""
    return split_address(address_or_default(address)).scheme == SIMULATION


def find_alike(world: World, config: LocalizationConfig, belief: Belief, *, prints: bool = False) -> list[Floats]:
    """Return the poses (3,) that look like that of an initial belief, and print them; none for a wide belief."""
    if is_wide(belief):
        return []
    x, y, heading = belief.mean[:POSE].tolist()
    found = AliasFinder(world.walls, config.clearance_in, [(x, y)]).aliases((x, y, heading))
    if found and prints:
        poses = ", ".join(f"({pose[0]:z.1f}, {pose[1]:z.1f}) in {math.degrees(pose[2]):z.0f} deg" for pose in found[:4])
        more = f" and {len(found) - 4} more" if len(found) > 4 else ""
        print(f"places that look like the start: {poses}{more}", flush=True)
    return found


def resolve_log_body(options: argparse.Namespace) -> Body:
    """Return the robot of a log: --body, or the last model of --model-file, or an N150."""
    name = options.body
    if not name:
        name = [*load_bodies(options.model_file)][-1] if options.model_file else N150.name
    return assumptions.resolve_body(name, options.model_file, None)


def make_folder(folder: Path) -> None:
    """Create a folder for results before anything is run. Raises OutputFileError."""
    with write_errors_as(OutputFileError, folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a result. Raises OutputFileError."""
    with write_errors_as(OutputFileError, path):
        path.write_text(text, encoding="utf-8")


def write_world(path: Path, world: World, comment: str) -> World:
    """Write a world file whose comment states how it was made, and return the world that it describes.

    Its text is read first, as any other: starts and paths must still be in free space.

    Raises
    ------
    WorldFileError, OutputFileError
    """
    text = format_world(world, comment)
    written = parse_world(text, str(path), world.name)
    write_text(path, text)
    return written


def check_writable(*files: Path | None) -> None:
    """Check before a run that files can be written at its end; create their folders. Raises OutputFileError."""
    for file in filter(None, files):
        make_folder(file.parent)
        real = Path(os.path.realpath(file))
        if real.is_dir() or not os.access(real if real.exists() else real.parent, os.W_OK):
            raise OutputFileError(f"{str(file)!r}: cannot be written: name a file in a writable folder")


def resolve_world(options: argparse.Namespace, map_name: str = "") -> World:
    """Return the world of --map, else of `map_name`, else of a sim: address; without one it is a usage error.

    Raises
    ------
    WorldFileError
        If the world cannot be read.
    AddressError
        If the address is invalid.
    """
    address = split_address(address_or_default(options.address))
    name = options.map or map_name
    if not name and address.scheme == SIMULATION:
        name = address.text.partition(":")[2].partition("?")[0] or DEFAULT_WORLD
    if not name:
        parse_address(address.text)
        options.refuse("a map is required: --map WORLD, a shipped world or a TOML file")
    return load_world(name)


# the initial belief


def prepare_localization(robot: Robot, simulated: bool, world: World, options: argparse.Namespace
                         ) -> tuple[Belief, LocalizationConfig, assumptions.SonarAssumption]:  # fmt: skip
    """Set the encoders if --start is given, and return the initial belief, the models and the assumed sonar model.

    A guessed sonar model is printed on stdout (stderr with --json).

    Raises
    ------
    EstimateFileError, WorldFileError
    """
    # 1. Pose: given, resumed, or from the encoders.
    state = _set_start(robot, robot.refresh(), options.start) if options.start else robot.refresh()
    calibration = load_calibration(options.calibration, options.body) if options.calibration else IDEAL_CALIBRATION
    belief = load_resumed_belief(options, world, state)
    if belief is None:
        pose = independent([state.x_in, state.y_in, state.steering_rad], options.start_std or START_STD)
        belief = with_wheels(pose, calibration) if options.calibration else with_parameters(pose, options.scale_std)
    options.driven_in = 0.0
    if start_source(options) == ENCODERS and not is_lockstep(options.address):
        belief = _widen_encoders(options, world, state, belief)
    options.method = options.method or (FINDER if is_wide(belief) or options.driven_in else DEFAULT_METHOD)
    # 2. Sonar model.
    body = assumptions.resolve_body(options.body, options.model_file, options.address)
    sonars = find_sonar_model(robot, simulated, None if options.start == UNKNOWN else belief, world, body, options)
    # 3. All models.
    # Of the methods only this one models the surfaces of walls; for the others a building has cones.
    building = sonars.building and options.method == DEFAULT_METHOD
    sonar = building_sonar(body.ring) if building else sonar_of(body.ring, rays=sonars.rays)
    return belief, LocalizationConfig.in_world(world, body, options.odometry_noise, sonar, calibration), sonars


def find_sonar_model(robot: Robot, simulated: bool, belief: Belief | None, world: World, body: Body,
                     options: argparse.Namespace) -> assumptions.SonarAssumption:
    """Return the assumed sonar model and print it if it is guessed, on stdout (stderr with --json).

    A simulation that does not report its model is decided by a round of readings; the robot stands meanwhile.
    """
    sonars = assumptions.resolve_sonar_model(options.sonars, simulated, options.address)
    if sonars.rays and sonars.guessed and body.ring.fits_state:
        _, state = restart_ring(robot, body.ring)
        end_s = (state.clock_s or 0.0) + body.ring.round_s + ROUND_MARGIN_S
        while (state.clock_s or 0.0) < end_s:
            robot.sleep(ROUND_MARGIN_S)
            state = robot.refresh()
        sonars = decide_by_readings(sonars, belief, state, world.walls, body)
    if sonars.line():
        print(sonars.line(), file=sys.stderr if options.json else sys.stdout, flush=True)
    return sonars


def _widen_encoders(options: argparse.Namespace, world: World, state: RobotState, belief: Belief) -> Belief:
    """Return the belief of encoders, wider by the drive since they were known, unless --start-std states it."""
    if options.start_std is not None:
        return belief
    starts = [(start.x_in, start.y_in, start.steering_rad) for start in world.starts]
    std, options.driven_in = saved_estimate.encoder_std(np.array([state.x_in, state.y_in, state.steering_rad]),
                                                        np.array([*starts, (0.0, 0.0, 0.0)]), np.array(START_STD),
                                                        options.odometry_noise)  # fmt: skip
    cov = belief.cov.copy()
    cov[range(POSE), range(POSE)] = np.square(std)
    return Belief(belief.mean, cov)


def start_source(options: argparse.Namespace) -> str:
    """Return where the start pose of a run comes from: resume, start, encoders or unknown."""
    if options.resume:
        return "resume"
    if options.start:
        return UNKNOWN if options.start == UNKNOWN else "start"
    return ENCODERS


def has_own_frame(options: argparse.Namespace, world: World, belief: Belief, true_start: Pose | None) -> bool:
    """Return True if the map has another frame than the simulated world, as a learned one has.

    That one has no rooms, but measured walls. Where the start is known, the true one is elsewhere in a map with another
    frame. Without --map the map is the world.
    """
    if options.map is None or world.rooms or not world.accuracies or true_start is None:
        return False
    if start_source(options) == UNKNOWN or is_wide(belief):
        return True
    off = np.abs(difference(np.array(true_start), belief.mean[:POSE]))
    return bool((off > MAX_START_SIGMAS * belief.std[:POSE]).any())


def describe_start(options: argparse.Namespace, belief: Belief) -> str:
    """Return the start pose, its deviation, and where it comes from, as a line of text."""
    source = start_source(options)
    if source == UNKNOWN:
        return "start unknown: the robot searches its pose first"
    (x, y, heading), std = belief.mean[:POSE].tolist(), belief.std[:POSE]
    origin = {"start": "given by --start", "resume": f"resumed from {options.resume}", ENCODERS: "from the encoders"}
    text = (
        f"start ({x:z.1f}, {y:z.1f}) in {math.degrees(heading):z.1f} deg ± {max(std[0], std[1]):.2g} in "
        f"{math.degrees(std[2]):.2g} deg, {origin[source]}"
    )
    # A simulation in this process has not driven yet.
    if options.driven_in:
        text += (
            f", {options.driven_in:.0f} in or more since they were known at a start of the map (method "
            f"{options.method}): give --start, --resume or --start-std if they are better"
        )
    elif source == ENCODERS and not is_lockstep(options.address):
        text += "; encoders drift while a robot drives: give --start or --resume, or a --start-std for it"
    return text


def _set_start(robot: Robot, state: RobotState, start: Sequence[float] | str) -> RobotState:
    """Set the encoders to the start pose, with the same angle between turret and body, and return the new state."""
    if start == UNKNOWN:
        return state
    x, y, heading = map(float, start)
    robot.set_position(x_in=x, y_in=y)
    return robot.set_angles(steering_rad=heading, turret_rad=heading + state.turret_rad - state.steering_rad)


def load_resumed_belief(options: argparse.Namespace, world: World, state: RobotState) -> Belief | None:
    """Return the belief of --resume at the first state; None without --resume. Raises EstimateFileError."""
    if options.resume is None:
        if options.displacement_std is not None:
            raise EstimateFileError("--displacement-std requires --resume FILE")
        return None
    if options.start:
        raise EstimateFileError("--start and --resume exclude each other: give one of them")
    saved = saved_estimate.load(options.resume)
    pose = np.array([state.x_in, state.y_in, state.steering_rad])
    now = EncoderPose.of(state.clock_s or 0.0, pose, state.turret_rad)
    signature = saved_estimate.map_signature(world, options.body)
    belief = saved_estimate.resume_belief(saved, signature, now, options.odometry_noise, options.displacement_std)
    # Parameters of --scale-std that the saved estimate does not contain are added.
    number = len(belief.mean) - POSE
    return with_parameters(belief, options.scale_std[number:])


def save_run(options: argparse.Namespace, world: World, run: Run) -> None:
    """Save the last estimate of a run, if --save is given. Raises EstimateFileError, also for a lost estimate."""
    last = run.moments[-1]
    save_estimate(options, world, last.estimate, last.odometry, last.turret_rad)


def save_estimate(options: argparse.Namespace, world: World, estimate: saved_estimate.Estimate,
                  odometry: tuple[float, float, float], turret_rad: float) -> None:  # fmt: skip
    """Save an estimate and the encoders, if --save is given: pose and odometry parameters, no other filter state.

    Raises EstimateFileError, also for a lost estimate.
    """
    if options.save is None:
        return
    if estimate.health.is_lost:
        raise EstimateFileError(f"{options.save}: not written, the estimate is lost: {estimate.health.reason}")
    encoders = EncoderPose.of(estimate.clock_s, np.array(odometry), turret_rad)
    belief = Belief(estimate.belief.mean[:MAX_STATE], estimate.belief.cov[:MAX_STATE, :MAX_STATE])
    signature = saved_estimate.map_signature(world, options.body)
    saved_estimate.save(options.save, saved_estimate.SavedEstimate(signature, encoders, belief))
