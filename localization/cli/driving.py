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
from localization.cli.assumptions import Taken, add_map, body_of, hint, world_of
from localization.cli.options import add_options as add_outset
from localization.cli.options import check_writable, opened, outset, pose
from localization.live.localizer import Echo
from localization.live.publish import Publisher
from localization.live.run import Witness
from localization.missions.controller import Helm, Showing
from localization.missions.report import Report
from localization.missions.settings import Point
from nclient import NomadError, Robot
from worlds.bodies import BODIES
from worlds.world import World

METHOD: Final = "finder"
"""It knows when it is lost."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """What all of them have."""
    add_map(parser, "what the mission says, or ")
    parser.add_argument("--start", type=pose, metavar="X,Y,HEADING",
                        help="where the robot stands now, inches and degrees; its encoders are set to it "
                             "(default: what they say)")
    add_outset(parser, METHOD, "the filter; all but finder never know that they are lost", "")
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
    world = world_of(options, map_name)
    check_writable(options.save, options.report)
    publisher = Publisher(options.publish) if options.publish else None
    robot, simulated = opened(options.address)
    with robot, contextlib.closing(publisher) if publisher else contextlib.nullcontext():
        options.body = body_of(options.body, robot.model.name, options.address)
        belief, known, sonars = outset(robot, simulated, world, options)
        body = BODIES[options.body]
        with Helm(robot, known, body, belief, time.sleep, options.method, options.speed) as helm:
            out = SetOut(helm, robot, simulated, sonars, [], [], world)
            helm.watchers.append(lambda sight: out.echoes.extend(sight.estimate.echoes))
            if publisher:
                helm.watchers.append(shown := Showing(publisher, Witness(robot, simulated), out.goals))
                shown(helm.sight)
            yield out
