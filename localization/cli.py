"""Drive a robot from way-point to way-point on the filter's estimate, on whatever address (`nomad localize`).

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
from dataclasses import astuple
from pathlib import Path

from localization import resuming
from localization.belief import Belief, independent
from localization.body_taken import body_of
from localization.calibrated import with_wheels
from localization.cone import ConeModel
from localization.filters.table import DEFAULT_METHOD, METHODS, finder
from localization.measurement import WIRE_SONAR
from localization.navigation import STOP_RADIUS_IN, Navigator, Speeds, begin, follow
from localization.obstruction import Obstruction
from localization.publishing import Publisher, message
from localization.readers import (
    UNKNOWN,
    check_writable,
    constants,
    noise,
    opened,
    point,
    positive,
    seconds,
    start,
    stds,
)
from localization.run import Moment, Run, Sighting
from localization.sonars_taken import taken
from localization.steadying import SteadyPose
from localization.surroundings import THESIS_ODOMETRY, Surroundings
from localization.systematic import with_constants
from nclient import NomadError, Robot, RobotState, WorldFileError
from nclient.errors import EstimateFileError
from nclient.exit_codes import ExitCode
from nclient.leaving import Left
from worlds.bodies import BODIES
from worlds.calibration import FAULTLESS, Calibration, load_calibration
from worlds.files import load_world
from worlds.world import World

START_STD = (0.1, 0.1, 0.01)
"""How well the robot is placed at the start: inches, inches, radians."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `nomad localize`."""
    parser.description = "Drive a robot to way-points, localizing it by its sonars against a map of walls."
    parser.epilog = "example: nomad localize 'sim:thesis_room?noisy=1&seed=1' --map thesis_room --waypoints 0,0 60,40"
    parser.add_argument("address", nargs="?", metavar="ADDRESS",
                        help="nserver://host[:port]/id, serial:///dev/ttyUSB0?model=n150, robotd://host or "
                             "sim:WORLD?noisy=1 (default: NOMAD_ROBOT, or a local nserver)")
    parser.add_argument("--map", "--world", required=True, metavar="WORLD",
                        help="the walls: a shipped world or a TOML file")
    goals = parser.add_mutually_exclusive_group(required=True)
    goals.add_argument("--waypoints", nargs="+", type=point, metavar="X,Y", help="where to go, in inches, in order")
    goals.add_argument("--path", metavar="NAME", help="a path of the map, by its figure's number, such as 5.8")
    parser.add_argument("--start", type=start, metavar="X,Y,HEADING",
                        help="where the robot stands now, inches and degrees; its encoders are set to it "
                             f"(default: what they say); {UNKNOWN}: it finds itself first (method finder)")
    parser.add_argument("--start-std", type=stds, default=START_STD, metavar="X,Y,HEADING",
                        help="how well that is known, inches and degrees (default 0.1,0.1,0.57)")
    parser.add_argument("--body", choices=sorted(BODIES),
                        help="the robot's model, where its address does not tell it (default n150)")
    parser.add_argument("--speed", type=positive, default=Speeds().translation_in_s, metavar="IN_S",
                        help="top speed in in/s (default %(default)s)")
    parser.add_argument("--radius", type=positive, default=STOP_RADIUS_IN, metavar="IN",
                        help="a way-point is reached within this (default %(default)s in)")
    parser.add_argument("--odometry-noise", type=noise, default=THESIS_ODOMETRY, metavar="A,B,C",
                        help="stds of what the encoders miss: in after 1 in, rad after 1 rad, rad after 1 in "
                             f"(default {','.join(str(value) for value in astuple(THESIS_ODOMETRY))})")
    parser.add_argument("--sonars", choices=("rays", "cones"),
                        help="how readings are understood: exact rays (setups ideal and noisy) or a real ring's cones, "
                             "with bad readings among them (default: as the setup of a sim: address has them, rays of "
                             "other simulations, cones of a robot)")
    parser.add_argument("--scale-std", type=constants, default=(), metavar="A[,B[,C]]",
                        help="find out the encoders' own errors, so uncertain at first: share of the way, share of the "
                             "turn, drift in rad/in (default: none; 0.05 is a worn robot's)")
    parser.add_argument("--calibration", type=Path, metavar="FILE",
                        help="what this robot's wheels and sonars get wrong: a model file as nomad calibrate writes; "
                             "counts before --scale-std")
    parser.add_argument("--method", choices=METHODS, default=DEFAULT_METHOD,
                        help="the filter: extended, iterated or unscented Kalman filter, particles, one that finds "
                             "itself again (default %(default)s); a smoother drives as ekf")
    parser.add_argument("--smooth", type=seconds, default=0.0, metavar="S",
                        help="spread corrections over S seconds for the steering; the estimate stays as it is "
                             "(default %(default)s)")
    parser.add_argument("--time-limit", type=positive, default=300.0, metavar="S",
                        help="give up after so many seconds of the robot's clock (default %(default)s)")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the run (needs the extra `plot`)")
    parser.add_argument("--publish", metavar="URL",
                        help="show estimate and echoes on the page of `nserver --viewer`, at the address that it "
                             "printed; way-points set there are gone to instead")
    resuming.add_arguments(parser)
    parser.add_argument("--stay", action="store_true",
                        help="with --publish: where there is nowhere left to go, stand and wait for way-points of the "
                             "page, until the time limit or Ctrl-C")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, alone on stdout")


def run(options: argparse.Namespace) -> int:
    """Do it. 0 when every way-point was reached, 3 when one was not; interrupted it still saves and tells."""
    world = load_world(options.map)
    if options.start == UNKNOWN and (options.resume or options.method not in (DEFAULT_METHOD, "finder")):
        raise EstimateFileError("--start unknown is for a robot that nothing is known of, and for --method finder "
                                "alone: leave --resume and other methods out")
    check_writable(options.save)
    points = [*options.waypoints] if options.waypoints else _points_of(world, options.path)
    if options.picture:
        from localization.drawing import require_matplotlib

        require_matplotlib()
    publisher = Publisher(options.publish) if options.publish else None
    robot, simulated = opened(options.address)
    done = Run(points)
    with robot:
        options.body = body_of(options.body, robot.model.name, options.address)
        try:
            _drive(robot, world, done, options, simulated, publisher)
        except (KeyboardInterrupt, Left):
            with contextlib.suppress(NomadError):
                robot.stop()
            _tell_interrupted(options, world, done)
            raise
        finally:
            if publisher:
                publisher.close()
    _tell(options, world, done)
    return ExitCode.DONE if done.reached == len(done.waypoints) else ExitCode.NOT_REACHED


def _tell(options: argparse.Namespace, world: World, done: Run) -> None:
    """What a run leaves: --save, --picture, the verdict."""
    resuming.save(options, world, done)
    if options.picture:
        from localization.drawing import draw_run

        draw_run(options.picture, world, done, BODIES[options.body])
    print(json.dumps(done.summary()) if options.json else done.verdict())


def _tell_interrupted(options: argparse.Namespace, world: World, done: Run) -> None:
    """The same of a run that Ctrl-C or a signal ends: what cannot be written is told, the ending stays what it was."""
    try:
        if done.moments:
            _tell(options, world, done)
    except NomadError as error:
        print(f"nomad: {error}", file=sys.stderr)


def _drive(
    robot: Robot, world: World, done: Run, options: argparse.Namespace, simulated: bool,
    publisher: Publisher | None = None,
) -> None:  # fmt: skip
    state = robot.refresh()
    nowhere = options.start == UNKNOWN
    if options.start and not nowhere:
        x, y, heading = options.start
        robot.set_position(x_in=x, y_in=y)
        turret_rad = heading + state.turret_rad - state.steering_rad
        state = robot.set_angles(steering_rad=heading, turret_rad=turret_rad)
    errs = load_calibration(options.calibration, options.body) if options.calibration else FAULTLESS
    belief = resuming.belief(options, world, state) or at_the_start(options, state, errs)
    done.sonars = taken(options.sonars, simulated, options.address)
    sonar = WIRE_SONAR if done.sonars.rays else ConeModel()
    if done.sonars.line():
        print(done.sonars.line(), file=sys.stderr if options.json else sys.stdout, flush=True)
    known = Surroundings(world.walls, BODIES[options.body], options.odometry_noise, sonar, errs=errs)
    stays = options.stay and publisher is not None
    navigator = Navigator(done.waypoints, Speeds(translation_in_s=options.speed), options.radius, stays=stays)
    seen = sighting(robot) if simulated else None
    number = robot.truth().robot_id if publisher and simulated else 1
    told_s = -math.inf
    steady, obstruction = SteadyPose(options.smooth), Obstruction(options.speed)
    method = finder(known, None, options.scale_std) if nowhere else options.method
    for progress in follow(robot, begin(robot, known, belief, method), navigator, time.sleep, steady):
        clock_s = progress.estimate.clock_s
        truth = None
        if seen:
            before, seen = seen, sighting(robot)
            truth = before.towards(seen, clock_s)
        told = progress.state
        odometry = (told.x_in, told.y_in, told.steering_rad)
        done.add(Moment(progress.estimate, odometry, truth, progress.passed, told.turret_rad))
        if publisher:
            turret_rad = told.turret_rad - told.steering_rad
            wanted = publisher.tell(message(number, done.moments[-1], turret_rad, done.waypoints))
            if wanted is not None:
                navigator.go(wanted)
                done.waypoints = wanted
        if not options.json and clock_s >= told_s + 1.0:
            told_s = clock_s
            print(done.line(), flush=True)
        aim = None if done.moments[-1].lost else navigator.goal
        done.stopped = obstruction.reason(clock_s, told, progress.estimate.pose, aim)
        if done.stopped or done.duration_s > options.time_limit:
            break


def at_the_start(options: argparse.Namespace, state: RobotState, errs: Calibration) -> Belief:
    """What is believed at the first state of a run that begins anew."""
    here = independent([state.x_in, state.y_in, state.steering_rad], options.start_std)
    return with_wheels(here, errs) if options.calibration else with_constants(here, options.scale_std)


def sighting(robot: Robot) -> Sighting:
    """The truth now, of a simulation."""
    truth = robot.truth()
    return Sighting(truth.time_s, (truth.x_in, truth.y_in, truth.steering_rad))


def _points_of(world: World, name: str) -> list[tuple[float, float]]:
    if name not in world.paths:
        there = ", ".join(world.paths) or "none"
        raise WorldFileError(f"the map {world.name} has no path {name!r}; it has {there}")
    return list(world.paths[name].points_in)
