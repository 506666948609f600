"""Setting out: the options of commands that drive by a plan, and the helm that they make of them.

Rules: reads options and opens the robot; what is driven is the command's. Waits on the real clock, for what the robot's
own has not gone by itself.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Final, NamedTuple

from localization import resuming
from localization.body_taken import body_of
from localization.cli import START_STD, at_the_start
from localization.cone import ConeModel
from localization.filters.table import METHODS
from localization.localizer import Echo
from localization.measurement import WIRE_SONAR
from localization.missions.helm import Helm
from localization.missions.report import Report
from localization.missions.settings import Point
from localization.missions.showing import Showing
from localization.navigation import Speeds
from localization.publishing import Publisher
from localization.readers import check_writable, constants, noise, opened, pose, positive, stds
from localization.sonars_taken import Taken, hint, taken
from localization.surroundings import THESIS_ODOMETRY, Surroundings
from nclient import NomadError, Robot, WorldFileError
from worlds.bodies import BODIES
from worlds.calibration import FAULTLESS, load_calibration
from worlds.files import load_world
from worlds.world import World

METHOD: Final = "finder"
"""It knows when it is lost."""
SIMULATION: Final = "sim:"


def add_options(parser: argparse.ArgumentParser) -> None:
    """What all of them have."""
    parser.add_argument("--map", "--world", metavar="WORLD",
                        help="the walls: a shipped world or a TOML file (default: what the mission says, or the world "
                             "of a sim: address)")
    parser.add_argument("--start", type=pose, metavar="X,Y,HEADING",
                        help="where the robot stands now, inches and degrees; its encoders are set to it "
                             "(default: what they say)")
    parser.add_argument("--start-std", type=stds, default=START_STD, metavar="X,Y,HEADING",
                        help="how well that is known, inches and degrees (default 0.1,0.1,0.57)")
    parser.add_argument("--body", choices=sorted(BODIES),
                        help="the robot's model, where its address does not tell it (default n150)")
    parser.add_argument("--speed", type=positive, default=Speeds().translation_in_s, metavar="IN_S",
                        help="top speed in in/s (default %(default)s)")
    parser.add_argument("--odometry-noise", type=noise, default=THESIS_ODOMETRY, metavar="A,B,C",
                        help="stds of what the encoders miss: in after 1 in, rad after 1 rad, rad after 1 in "
                             f"(default {','.join(str(value) for value in astuple(THESIS_ODOMETRY))})")
    parser.add_argument("--sonars", choices=("rays", "cones"),
                        help="how readings are understood (default: as the setup of a sim: address has them, rays of "
                             "other simulations, cones of a robot)")
    parser.add_argument("--scale-std", type=constants, default=(), metavar="A[,B[,C]]",
                        help="find out the encoders' own errors, as in `nomad localize`")
    parser.add_argument("--calibration", type=Path, metavar="FILE",
                        help="what this robot's wheels and sonars get wrong: a model file as nomad calibrate writes; "
                             "counts before --scale-std")
    resuming.add_arguments(parser)
    parser.add_argument("--method", choices=METHODS, default=METHOD,
                        help="the filter; all but finder never know that they are lost (default %(default)s)")
    parser.add_argument("--publish", metavar="URL",
                        help="show estimate and echoes on the page of `nserver --viewer`, at the address printed")
    parser.add_argument("--json", action="store_true", help="print the report as JSON, alone on stdout")


class SetOut(NamedTuple):
    """A helm, its robot, whether that knows the truth, for what its sonars are taken, and all that was heard."""

    helm: Helm
    robot: Robot
    simulated: bool
    sonars: Taken
    echoes: list[Echo]
    goals: list[Point]
    """What the page shows as way-points."""
    world: World

    def close(self, report: Report) -> Report:
        """The report with where the robot is at the end; first of all it is stopped, whatever becomes of the report."""
        with contextlib.suppress(NomadError):
            self.robot.stop()
        report.hint = hint(self.sonars, self.echoes)
        belief = self.helm.sight.estimate.belief
        x, y, heading = (float(value) for value in self.helm.sight.estimate.pose)
        report.pose = x, y, heading
        sx, sy, turned = (float(value) for value in belief.std[:3])
        report.std = sx, sy, turned
        with contextlib.suppress(NomadError):
            if self.simulated:
                truth = self.robot.truth()
                report.truth = truth.x_in, truth.y_in, truth.steering_rad
        return report


    def keep(self, options: argparse.Namespace) -> bool:
        """--save; False where that could not be, which is told on stderr: what has ended the run stays what it was."""
        estimate, state = self.helm.sight
        try:
            resuming.keep(options, self.world, estimate, (state.x_in, state.y_in, state.steering_rad), state.turret_rad)
        except NomadError as error:
            print(f"nomad: {error}", file=sys.stderr)
            return False
        return True


@contextlib.contextmanager
def set_out(options: argparse.Namespace, map_name: str = "") -> Iterator[SetOut]:
    """Connect to the robot of the options, and begin to localize it; it stands at the end, however it ends."""
    world = load_world(_map_of(options, map_name))
    check_writable(options.save, options.report)
    publisher = Publisher(options.publish) if options.publish else None
    robot, simulated = opened(options.address)
    with robot, contextlib.closing(publisher) if publisher else contextlib.nullcontext():
        options.body = body_of(options.body, robot.model.name, options.address)
        body = BODIES[options.body]
        state = robot.refresh()
        if options.start:
            x, y, heading = options.start
            robot.set_position(x_in=x, y_in=y)
            turret_rad = heading + state.turret_rad - state.steering_rad
            state = robot.set_angles(steering_rad=heading, turret_rad=turret_rad)
        errs = load_calibration(options.calibration, options.body) if options.calibration else FAULTLESS
        belief = resuming.belief(options, world, state) or at_the_start(options, state, errs)
        sonars = taken(options.sonars, simulated, options.address)
        if sonars.line():
            print(sonars.line(), file=sys.stderr if options.json else sys.stdout, flush=True)
        known = Surroundings(world.walls, body, options.odometry_noise, WIRE_SONAR if sonars.rays else ConeModel(),
                             errs=errs)
        with Helm(robot, known, body, belief, time.sleep, options.method, options.speed) as helm:
            out = SetOut(helm, robot, simulated, sonars, [], [], world)
            helm.watchers.append(lambda sight: out.echoes.extend(sight.estimate.echoes))
            if publisher:
                helm.watchers.append(shown := Showing(publisher, robot, simulated, out.goals))
                shown(helm.sight)
            yield out


def _map_of(options: argparse.Namespace, map_name: str) -> str:
    """The option's, the mission's, or the simulation's own. Raises WorldFileError where none is told."""
    address = options.address or ""
    own = address.removeprefix(SIMULATION).partition("?")[0] if address.startswith(SIMULATION) else ""
    told = options.map or map_name or own
    if not told:
        raise WorldFileError("which walls are there? --map WORLD, a shipped world or a TOML file")
    return str(told)
