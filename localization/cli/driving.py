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
from typing import Final, NamedTuple

from localization.cli import options as resuming
from localization.cli.options import add_options as add_outset
from localization.cli.options import check_writable, open_robot, pose, prepare_localization
from localization.live.assumptions import Taken, add_map_option, hint, resolve_robot_model, resolve_world
from localization.live.localizer import Echo
from localization.live.publish import Publisher
from localization.live.run import GroundTruth
from localization.missions.controller import ProgressPublisher, RobotController
from localization.missions.report import Report
from localization.missions.settings import Point
from nclient import NomadError, Robot
from worlds.robots import BODIES
from worlds.world import World

METHOD: Final = "finder"
"""It knows when it is lost."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """What all of them have."""
    add_map_option(parser, "what the mission says, or ")
    parser.add_argument(
        "--start",
        type=pose,
        metavar="X,Y,HEADING",
        help="where the robot stands now, inches and degrees; its encoders are set to it (default: what they say)",
    )
    add_outset(parser, METHOD, "the filter; all but finder never know that they are lost", "")
    parser.add_argument("--json", action="store_true", help="print the report as JSON, alone on stdout")


class MissionContext(NamedTuple):
    """A helm, its robot, whether that knows the truth, for what its sonars are taken, and all that was heard."""

    controller: RobotController
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
        belief = self.controller.sight.estimate.belief
        x, y, heading = (float(value) for value in self.controller.sight.estimate.pose)
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
        estimate, state = self.controller.sight
        try:
            resuming.keep(options, self.world, estimate, (state.x_in, state.y_in, state.steering_rad), state.turret_rad)
        except NomadError as error:
            print(f"nomad: {error}", file=sys.stderr)
            return False
        return True


@contextlib.contextmanager
def open_mission(options: argparse.Namespace, map_name: str = "") -> Iterator[MissionContext]:
    """Connect to the robot of the options, and begin to localize it; it stands at the end, however it ends."""
    world = resolve_world(options, map_name)
    check_writable(options.save, options.report)
    publisher = Publisher(options.publish) if options.publish else None
    robot, simulated = open_robot(options.address)
    with robot, contextlib.closing(publisher) if publisher else contextlib.nullcontext():
        options.body = resolve_robot_model(options.body, robot.model.name, options.address)
        belief, known, sonars = prepare_localization(robot, simulated, world, options)
        body = BODIES[options.body]
        with RobotController(robot, known, body, belief, time.sleep, options.method, options.speed) as controller:
            out = MissionContext(controller, robot, simulated, sonars, [], [], world)
            controller.watchers.append(lambda sight: out.echoes.extend(sight.estimate.echoes))
            if publisher:
                controller.watchers.append(
                    shown := ProgressPublisher(publisher, GroundTruth(robot, simulated), out.goals)
                )
                shown(controller.sight)
            yield out
