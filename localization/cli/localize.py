"""Drive a robot from way-point to way-point on the filter's estimate, on whatever address.

Rules: reads options, prints, waits on the real clock; what drives and what estimates is navigation's and localizer's.
Where the other end is our simulation the true error is printed beside the estimate; the filter never sees the truth.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
import time
from pathlib import Path

from localization.cli import options as resuming
from localization.cli.options import (
    UNKNOWN,
    add_options,
    check_writable,
    open_robot,
    point,
    positive,
    prepare_localization,
    seconds,
    start,
)
from localization.filters.registry import DEFAULT_METHOD, FINDER, finder
from localization.live.assumptions import add_map_option, resolve_robot_model, resolve_world
from localization.live.publish import Publisher, message
from localization.live.run import GroundTruth, Run, RunMoment
from localization.navigation.recovery import StallDetector
from localization.navigation.speed import PoseSmoother
from localization.navigation.waypoints import STOP_RADIUS_IN, Navigator, Progress, Speeds, begin, follow
from nclient import NomadError, Robot, WorldFileError
from nclient.common.exit_codes import ExitCode
from nclient.common.process import TerminatedBySignal
from worlds.robots import BODIES
from worlds.world import World


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `nomad localize`."""
    parser.description = "Drive a robot to way-points, localizing it by its sonars against a map of walls."
    parser.epilog = "example: nomad localize 'sim:thesis_room?noisy=1&seed=1' --waypoints 0,0 60,40"
    parser.add_argument(
        "address",
        nargs="?",
        metavar="ADDRESS",
        help="nserver://host[:port]/id, serial:///dev/ttyUSB0?model=n150, robotd://host or "
        "sim:WORLD?noisy=1 (default: NOMAD_ROBOT, or a local nserver)",
    )
    add_map_option(parser)
    goals = parser.add_mutually_exclusive_group()
    goals.add_argument("--waypoints", nargs="+", type=point, metavar="X,Y", help="where to go, in inches, in order")
    goals.add_argument("--path", metavar="NAME", help="a path of the map, by its figure's number, such as 5.8")
    parser.add_argument(
        "--start",
        type=start,
        metavar="X,Y,HEADING",
        help="where the robot stands now, inches and degrees; its encoders are set to it "
        f"(default: what they say); {UNKNOWN}: it finds itself first (method finder)",
    )
    add_options(
        parser,
        DEFAULT_METHOD,
        "the filter: extended, iterated or unscented Kalman filter, particles, one that finds itself again; a "
        "smoother drives as ekf",
        "; way-points set there are gone to instead",
    )
    parser.set_defaults(method=None)
    parser.add_argument(
        "--radius",
        type=positive,
        default=STOP_RADIUS_IN,
        metavar="IN",
        help="a way-point is reached within this (default %(default)s in)",
    )
    parser.add_argument(
        "--smooth",
        type=seconds,
        default=0.0,
        metavar="S",
        help="spread corrections over S seconds for the steering; the estimate stays as it is (default %(default)s)",
    )
    parser.add_argument(
        "--time-limit",
        type=positive,
        default=300.0,
        metavar="S",
        help="give up after so many seconds of the robot's clock (default %(default)s)",
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the run (needs the extra `plot`)")
    parser.add_argument(
        "--stay",
        action="store_true",
        help="with --publish: where there is nowhere left to go, or no way-point was given, stand and "
        "wait for way-points of the page, until the time limit or Ctrl-C",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON, alone on stdout")


def run(options: argparse.Namespace) -> int:
    """Do it. 0 when every way-point was reached, 3 when one was not; interrupted it still saves and tells."""
    world = resolve_world(options)
    options.method = _method(options)
    check_writable(options.save)
    points = _goals(options, world)
    if options.picture is not None:
        from localization.live.plot import check_picture

        check_picture(options.picture)
    publisher = Publisher(options.publish) if options.publish else None
    robot, simulated = open_robot(options.address)
    done = Run(points)
    with robot:
        options.body = resolve_robot_model(options.body, robot.model.name, options.address)
        try:
            _drive(robot, world, done, options, simulated, publisher)
        except (KeyboardInterrupt, TerminatedBySignal):
            with contextlib.suppress(NomadError):
                robot.stop()
            if done.moments:
                _tell(options, world, done)
            raise
        finally:
            if publisher:
                publisher.close()
    written = _tell(options, world, done)
    if done.reached < len(done.waypoints):
        return ExitCode.NOT_REACHED
    return ExitCode.DONE if written else ExitCode.FAILED


def _method(options: argparse.Namespace) -> str:
    """The one asked for, or the default; of a robot that nothing is known of another."""
    if options.start == UNKNOWN:
        if options.resume:
            options.refuse(f"--start {UNKNOWN} begins with nothing, and --resume goes on: leave one of them out")
        if options.method not in (None, FINDER):
            options.refuse(
                f"--start {UNKNOWN} is found out by --method {FINDER} alone: leave --method {options.method} out"
            )
        return FINDER
    method: str = options.method or DEFAULT_METHOD
    return method


def _tell(options: argparse.Namespace, world: World, done: Run) -> bool:
    """What a run leaves: --save, --picture, the verdict. False where one could not be written, which is told on stderr:
    what has ended the run stays what it was."""
    written = True
    for write in (resuming.save, _draw):
        try:
            write(options, world, done)
        except NomadError as error:
            written = False
            print(f"nomad: {error}", file=sys.stderr)
    print(json.dumps(done.summary()) if options.json else done.verdict(), flush=True)
    return written


def _draw(options: argparse.Namespace, world: World, done: Run) -> None:
    if options.picture is not None:
        from localization.live.plot import draw_run

        draw_run(options.picture, world, done, BODIES[options.body])


def _drive(
    robot: Robot, world: World, done: Run, options: argparse.Namespace, simulated: bool,
    publisher: Publisher | None = None,
) -> None:  # fmt: skip
    belief, known, done.sonars = prepare_localization(robot, simulated, world, options)
    stays = options.stay and publisher is not None
    navigator = Navigator(done.waypoints, Speeds(translation_in_s=options.speed), options.radius, stays=stays)
    method = finder(known, None, options.scale_std) if options.start == UNKNOWN else options.method
    localizer = begin(robot, known, belief, method)
    witness, obstruction, told_s = GroundTruth(robot, simulated), StallDetector(options.speed), -math.inf
    for progress in follow(robot, localizer, navigator, time.sleep, PoseSmoother(options.smooth)):
        clock_s, state = progress.estimate.clock_s, progress.state
        done.add(_moment(progress, witness))
        if publisher:
            _publish(publisher, done, navigator, witness.robot_id)
        if not options.json and clock_s >= told_s + 1.0:
            told_s = clock_s
            print(done.line(), flush=True)
        aim = None if done.moments[-1].lost else navigator.goal
        done.stopped = obstruction.reason(clock_s, state, progress.estimate.pose, aim)
        if not done.stopped and done.duration_s > options.time_limit:
            done.stopped = f"its time is over: {options.time_limit:g} s (--time-limit)"
        if done.stopped:
            break


def _moment(progress: Progress, witness: GroundTruth) -> RunMoment:
    state = progress.state
    truth = witness.at(progress.estimate.clock_s)
    odometry = (state.x_in, state.y_in, state.steering_rad)
    return RunMoment(progress.estimate, odometry, truth, progress.passed, state.turret_rad)


def _publish(publisher: Publisher, done: Run, navigator: Navigator, robot_id: int) -> None:
    """Show the last moment; way-points that the page has set are gone to from now on."""
    last = done.moments[-1]
    wanted = publisher.tell(message(robot_id, last, last.turret_rad - last.odometry[2], done.waypoints))
    if wanted is not None:
        navigator.go(wanted)
        done.waypoints = wanted


def _goals(options: argparse.Namespace, world: World) -> list[tuple[float, float]]:
    if options.waypoints:
        return [*options.waypoints]
    if options.path is not None:
        return _points_of(world, options.path)
    if not (options.stay and options.publish):
        options.refuse("where to? --waypoints X,Y or --path NAME; only --stay with --publish waits for the page's")
    return []


def _points_of(world: World, name: str) -> list[tuple[float, float]]:
    if name not in world.paths:
        there = ", ".join(world.paths) or "none"
        raise WorldFileError(f"the map {world.name} has no path {name!r}; it has {there}")
    return list(world.paths[name].points_in)
