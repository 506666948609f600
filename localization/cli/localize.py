"""Drive a robot from waypoint to waypoint on the filter's estimate.

    nomad localize "sim:thesis_room?noisy=1&seed=1" --waypoints 0,0 60,40
    nomad localize nserver://localhost:7019/1 --map thesis_room --path 5.8 --picture run.png
    nomad localize --from drive.log --map room.toml             a recorded drive

For a simulated robot the true error is printed beside the estimate, on a learned map at the end: its frame is free. The
filter never uses the ground truth.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from localization.cli import arguments
from localization.cli.arguments import START_STD, UNKNOWN, check_writable, resolve_log_body
from localization.filters.base import LocalizationConfig
from localization.filters.belief import POSE, independent
from localization.filters.global_localization import WIDE_IN, WIDE_RAD, is_wide
from localization.filters.odometry import with_parameters
from localization.filters.registry import DEFAULT_METHOD, FINDER, make
from localization.filters.sonar_cone import ConeSonar, building_sonar, cone_sonar
from localization.filters.sonar_ray import RaySonar, ray_sonar
from localization.live.assumptions import BUILDING_SETUP, resolve_body, resolve_robot_model
from localization.live.background_search import filter_on_robot
from localization.live.run import GroundTruth, Publisher, Run, build_message, run_log
from localization.live.sensor_input import read_log, without_echo
from localization.navigation.control_law import ContactDetector, MisfitDetector, PoseSmoother, StallDetector
from localization.navigation.waypoints import STOP_RADIUS_IN, Navigator, Speeds, follow_waypoints, start_localizer
from localization.plot import check_picture, draw_run
from nclient import NomadError, Robot, WorldFileError
from nclient.cli.serving import print_message
from nclient.common.arguments import add_address, add_flag, add_value
from nclient.common.process import ExitCode, TerminatedBySignal
from nclient.recording import convert
from worlds.geometry import crossings
from worlds.io import load_world
from worlds.rings import Ring
from worlds.world import World


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad localize`."""
    add_address(parser)
    arguments.add_map_option(parser)
    goals = parser.add_mutually_exclusive_group()
    goals.add_argument("--waypoints", nargs="+", type=arguments.parse_point, metavar="X,Y",
                       help="drive to these positions in order, inches")
    goals.add_argument("--path", metavar="NAME",
                       help="drive a path of the map, given by the number of its figure, such as 5.8")
    add_value(parser, "--start", "X,Y,HEADING", arguments.parse_start,
              "set the encoders to this initial pose, inches and degrees (default: keep them); "
              f"{arguments.UNKNOWN}: find the pose first (method finder)")
    arguments.add_localization_options(
        parser,
        DEFAULT_METHOD,
        "filter: extended, iterated or unscented Kalman filter, particles, or one that recovers when lost; smoother "
        f"drives like ekf; finder is the default with --start {arguments.UNKNOWN} or a --start-std above "
        f"{WIDE_IN:g} in or {math.degrees(WIDE_RAD):.1f} deg",
        "; waypoints set there replace the current ones",
    )
    parser.set_defaults(method=None)
    add_log_options(parser)
    add_value(parser, "--radius", "IN", arguments.parse_positive,
              "count a waypoint as reached within this many inches", STOP_RADIUS_IN)
    add_value(parser, "--smooth", "S", arguments.parse_seconds,
              "smooth the pose used for steering over S seconds; the estimate is unaffected", 0.0)
    add_value(parser, "--time-limit", "S", arguments.parse_positive,
              "give up after this many seconds of the robot's clock", 300.0)
    add_value(parser, "--picture", "PNG", Path, "draw the run into this file (needs the extra `plot`)")
    add_flag(parser, "--stay",
             "with --publish: after the last waypoint, or without any, stand and wait for waypoints "
             "set on the page, until the time limit or Ctrl-C")
    add_flag(parser, "--json", "print only the result, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code: 0 if all waypoints were reached, 3 if not.

    After Ctrl-C or a signal results are still saved and printed.
    """
    options.method = _select_method(options)
    take_replayed_drive(options)
    if options.log:
        return localize_recorded(options)
    # 1. Everything that can fail without a robot.
    world = arguments.resolve_world(options)
    arguments.check_writable(options.save)
    points = _goals(options, world)
    for x, y in points:
        if world.clearance(x, y) <= 0.0:
            raise WorldFileError(f"waypoint {x:g},{y:g} is not in the free space of the map {world.name}")
    given = [options.start[:2]] if options.start and options.start != arguments.UNKNOWN else []
    _require_free_legs(world, [*given, *points])
    check_picture(options.picture)
    publisher = Publisher(options.publish) if options.publish else None
    # 2. Drive.
    robot, simulated = arguments.open_robot(options.address)
    done = Run(points)
    with robot, contextlib.closing(publisher) if publisher else contextlib.nullcontext():
        options.body = resolve_robot_model(options.body, robot.model.name, options.address)
        try:
            _drive(robot, world, done, options, simulated, publisher)
        except (KeyboardInterrupt, TerminatedBySignal):
            with contextlib.suppress(NomadError):
                robot.stop()
            if done.moments:
                _write_results(options, world, done)
            raise
    # 3. Results.
    written = _write_results(options, world, done)
    if done.reached < len(done.waypoints):
        return ExitCode.NOT_REACHED
    return ExitCode.DONE if written else ExitCode.FAILED


def _select_method(options: argparse.Namespace) -> str:
    """Return the method of --method, its default, or the one that finds an unknown start; "" if the robot decides."""
    # Only this filter needs no initial pose, or searches where a wide one covers several.
    if options.start == arguments.UNKNOWN:
        if options.resume:
            options.refuse("--start unknown and --resume exclude each other: give one of them")
        if options.method not in (None, FINDER):
            method = options.method
            options.refuse(f"--start unknown is found out by --method {FINDER} alone: leave --method {method} out")
        return FINDER
    # A log has no robot that could drive to where poses differ.
    if options.log:
        return str(options.method or DEFAULT_METHOD)
    std = options.start_std
    if std is not None and not options.resume and is_wide(independent((0.0, 0.0, 0.0), std)):
        return str(options.method or FINDER)
    # Encoders have the deviations of their drive, which the robot reports.
    is_open = std is None and arguments.start_source(options) == arguments.ENCODERS
    return str(options.method or ("" if is_open else DEFAULT_METHOD))


def _write_results(options: argparse.Namespace, world: World, done: Run) -> bool:
    """Write --save and --picture and print the result; return False if a file could not be written (see stderr)."""
    written = True
    if done.has_own_frame:
        done.fit_truth()
    # One file that cannot be written must not prevent the other, nor the printed result.
    for write in (arguments.save_run, _draw):
        try:
            write(options, world, done)
        except NomadError as error:
            written = False
            print_message(str(error))
    print(json.dumps(done.summary()) if options.json else done.verdict(), flush=True)
    return written


def _draw(options: argparse.Namespace, world: World, done: Run) -> None:
    if options.picture is not None:
        draw_run(options.picture, world, done, resolve_body(options.body, options.model_file, options.address))


def _drive(robot: Robot, world: World, done: Run, options: argparse.Namespace, simulated: bool,
           publisher: Publisher | None = None) -> None:  # fmt: skip
    # 1. Initial belief, models, controller and filter.
    belief, config, done.sonars = arguments.prepare_localization(robot, simulated, world, options)
    stays = options.stay and publisher is not None
    navigator = Navigator(done.waypoints, Speeds(translation_in_s=options.speed), options.radius, stays=stays)
    done.start = arguments.start_source(options)
    if not options.json:
        print(arguments.describe_start(options, belief), flush=True)
    start = None if done.start == arguments.UNKNOWN else belief
    # The first leg begins where the encoders or --resume say.
    if start is not None and not is_wide(start):
        x, y = start.mean[:2].tolist()
        _require_free_legs(world, [(x, y), *done.waypoints[:1]])
    waits = arguments.is_lockstep(options.address)
    done.alike = [] if start is None else arguments.find_alike(world, config, start, prints=not options.json)
    with filter_on_robot(
        options.method, config, start, options.scale_std, waits=waits, report=print_message, alike=done.alike
    ) as method:
        localizer = start_localizer(robot, config, belief, method)
        # 2. Drive until the last waypoint, a contact, a stall or the time limit.
        ground_truth, printed_s = GroundTruth(robot, simulated), -math.inf
        done.has_own_frame = arguments.has_own_frame(options, world, belief, ground_truth.first)
        stall_detector, contact_detector = StallDetector(options.speed), ContactDetector()
        misfit_detector = None if options.method == FINDER else MisfitDetector()
        for progress in follow_waypoints(robot, localizer, navigator, robot.sleep, PoseSmoother(options.smooth)):
            clock_s, state = progress.estimate.clock_s, progress.state
            # Record, publish, print.
            done.add(ground_truth.moment(*progress))
            if publisher:
                _publish(publisher, done, navigator, ground_truth.robot_id)
            if not options.json and clock_s >= printed_s + 1.0:
                printed_s = clock_s
                print(done.line(), flush=True)
            # End on a contact, a misfit, a stall or at the time limit. A lost robot searches, and backs off by itself.
            is_lost = done.moments[-1].lost
            aim = None if is_lost else navigator.goal
            # Without a waypoint another program drives, and a contact is no failure of this run.
            backs_off = is_lost or (stays and aim is None)
            done.stopped = contact_detector.reason(state, progress.estimate.pose, backs_off=backs_off)
            if misfit_detector and not done.stopped:
                done.stopped = misfit_detector.reason(progress.estimate)
            done.stopped = done.stopped or stall_detector.reason(clock_s, state, progress.estimate.pose, aim)
            if not done.stopped and done.duration_s > options.time_limit:
                done.stopped = f"time limit exceeded: {options.time_limit:g} s (--time-limit)"
            if done.stopped:
                break


def _publish(publisher: Publisher, done: Run, navigator: Navigator, robot_id: int) -> None:
    """Publish the last period; waypoints set on the page replace the current ones."""
    # The page shows the error: in the frame of a learned map there is none yet.
    moment = done.moments[-1]._replace(truth=None) if done.has_own_frame else done.moments[-1]
    waypoints = publisher.publish(build_message(robot_id, moment, done.waypoints))
    if waypoints is not None:
        navigator.set_waypoints(waypoints)
        done.waypoints = waypoints


def _goals(options: argparse.Namespace, world: World) -> list[tuple[float, float]]:
    if options.waypoints:
        return [*options.waypoints]
    if options.path is not None:
        if options.path not in world.paths:
            names = ", ".join(world.paths) or "none"
            raise WorldFileError(f"the map {world.name} has no path {options.path!r}; it has {names}")
        return list(world.paths[options.path].points_in)
    # Waypoints may also come from the page later.
    if not (options.stay and options.publish):
        options.refuse("a goal is required: --waypoints X,Y or --path NAME, or --stay with --publish")
    return []


def _require_free_legs(world: World, points: Sequence[tuple[float, float]]) -> None:
    """Raise WorldFileError for two successive points with a wall of a map between them."""
    for (x, y), (to_x, to_y) in pairwise(points):
        if crossings(np.array([[x, y, to_x, to_y]]), world.walls).any():
            raise WorldFileError(
                f"the leg from {x:.5g},{y:.5g} to {to_x:g},{to_y:g} leads through a wall of the map {world.name}: "
                "give waypoints around it, or use nomad go, which plans the way"
            )


REPLAY: Final = "replay:"
ROBOT_OPTIONS: Final = ("address", "waypoints", "path", "publish", "save", "resume", "calibration", "stay")
"""Options of `nomad localize` that need a robot."""


SONARS: Final[Mapping[str, Callable[[Ring], RaySonar | ConeSonar]]] = MappingProxyType(
    {"rays": ray_sonar, "cones": cone_sonar, BUILDING_SETUP: building_sonar}
)
"""The sonar models by their names in --sonars."""


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add --from and --estimates."""
    parser.add_argument("--from", dest="log", type=Path, metavar="LOG",
                        help="localize a recorded drive instead of a robot: a recording, bag, MCAP or CARMEN log as "
                             "nomad convert reads them, or CSV with columns time_s, x_in, y_in, heading_deg, "
                             "sonar_0_in ... (page Real data of the manual)")  # fmt: skip
    parser.add_argument("--estimates", type=Path, metavar="FILE.csv",
                        help="with --from: write the estimate at each row, inches and degrees")  # fmt: skip


def take_replayed_drive(options: argparse.Namespace) -> None:
    """Make `--from FILE` of the address `replay:FILE`, if the file has a drive without the bytes of a recording.

    Such a file has readings and no instants of firing, which a filter on a live robot knows.
    """
    if not (options.address or "").startswith(REPLAY):
        return
    file = Path(options.address.removeprefix(REPLAY).partition("?")[0])
    if convert.may_be_drive(file, or_csv=True) and not convert.read_drive(file).traffic:
        options.address, options.log = None, file


def localize_recorded(options: argparse.Namespace) -> int:
    """Run `nomad localize --from`; return the exit code.

    Raises
    ------
    LogFileError, WorldFileError, OutputFileError
    """
    # 1. Everything that can fail.
    for name in ROBOT_OPTIONS:
        if getattr(options, name):
            option = name.upper() if name == "address" else f"--{name}"
            options.refuse(f"--from localizes a recorded drive: leave {option} out")
    if not options.map:
        options.refuse("a map is required: --map WORLD, a shipped world or a TOML file")
    if options.start == UNKNOWN:
        options.refuse(f"--start {UNKNOWN} needs a robot: give the pose at the first row of the log")
    world, body = load_world(options.map), resolve_log_body(options)
    check_writable(options.estimates, options.picture)
    check_picture(options.picture)
    rows = without_echo(read_log(options.log), body.ring)
    # 2. Initial belief and models.
    belief = independent(options.start or rows[0].odometry, options.start_std or START_STD)
    belief = with_parameters(belief, options.scale_std)
    sonar = SONARS[options.sonars or BUILDING_SETUP](body.ring)
    config = LocalizationConfig.in_world(world, body, options.odometry_noise, sonar)
    # 3. Run, results.
    done = run_log(rows, body.ring.round_s, make(options.method, config, belief))
    if options.estimates:
        arguments.write_text(options.estimates, _table(done))
    if options.picture:
        draw_run(options.picture, world, done, body)
    print(json.dumps(done.summary()) if options.json else done.verdict(), flush=True)
    return ExitCode.DONE


def _table(done: Run) -> str:
    """Return the estimates as CSV."""
    lines = ["time_s,x_in,y_in,heading_deg,x_std_in,y_std_in,heading_std_deg,health"]
    for moment in done.moments:
        estimate = moment.estimate
        (x, y, heading), std = estimate.pose.tolist(), estimate.belief.std[:POSE].tolist()
        numbers = (estimate.clock_s, x, y, math.degrees(heading), std[0], std[1], math.degrees(std[2]))
        lines.append(",".join([*(f"{number:.4f}" for number in numbers), estimate.health.status.value]))
    return "\n".join(lines) + "\n"
