"""Run a mission, a Python program or a list of steps in TOML.

    nomad mission docs/missions/rounds.toml "sim:several_walls?noisy=1&seed=3&start=5,5"
    nomad mission docs/missions/look_around.py nserver://localhost:7019/1 --map several_walls --report r.json

Exit code 0: completed; 3: a step failed. The robot is stopped at the end, after errors and on Ctrl-C, and the report is
written in all cases.
"""

import argparse
import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from localization.cli import arguments
from localization.live.assumptions import SonarAssumption, resolve_body, resolve_robot_model, sonar_mismatch_hint
from localization.live.background_search import filter_on_robot
from localization.live.localizer import Echo
from localization.live.publish import Publisher
from localization.live.run import GroundTruth
from localization.navigation.controller import ProgressPublisher, RobotController
from localization.navigation.mission import Mission, run_mission
from localization.navigation.mission_report import Report
from localization.navigation.mission_settings import Point, Settings
from localization.navigation.mission_steps import load_mission
from nclient import NomadError, Robot
from nclient.common.arguments import add_address, add_flag, add_value
from nclient.common.files import write_errors_as
from nclient.common.process import ExitCode
from nclient.errors import MissionFileError
from worlds.io import load_world
from worlds.world import World

METHOD: Final = "finder"
"""Default filter: it detects when it is lost."""
# Exit code 3, as of other commands that ran and did not succeed.
FAILED: Final = ExitCode.NOT_REACHED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad mission`."""
    parser.add_argument("file", metavar="FILE", help="mission file, .toml or .py (docs/missions.md)")
    add_address(parser)
    add_flag(parser, "--check", "check the file and its map, report errors, move nothing")
    add_value(parser, "--report", "JSON", Path, "write the report to this file")
    add_mission_options(parser)


def add_mission_options(parser: argparse.ArgumentParser) -> None:
    """Add the options shared by `nomad mission` and `nomad go`."""
    arguments.add_map_option(parser, "that of the mission, or ")
    add_value(parser, "--start", "X,Y,HEADING", arguments.parse_pose,
              "set the encoders to this initial pose, inches and degrees (default: keep them)")
    arguments.add_localization_options(parser, METHOD, "filter; only finder detects that it is lost", "")
    add_flag(parser, "--json", "print only the report, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    # 1. Everything that can be checked without a robot: file, steps and map.
    spec = load_mission(options.file)
    if options.map:
        load_world(options.map)
    else:
        spec.check_map()
    if options.check:
        print(f"{options.file}: a mission{f', {spec.settings.title}' if spec.settings.title else ''}")
        return 0
    # 2. The mission on the robot.
    with open_mission(options, spec.settings.map) as context:
        return execute_mission(context, spec.settings, spec.run, options)


class MissionContext(NamedTuple):
    """A controlled robot and what its mission's report and page need."""

    controller: RobotController
    robot: Robot
    simulated: bool
    sonars: SonarAssumption
    echoes: list[Echo]
    goals: list[Point]
    """Waypoints shown on the page."""
    world: World

    def complete_report(self, report: Report) -> Report:
        """Stop the robot and add its final pose to the report."""
        with contextlib.suppress(NomadError):
            self.robot.stop()
        # Pose and standard deviations: inches, inches, radians.
        report.hint = sonar_mismatch_hint(self.sonars, self.echoes)
        estimate = self.controller.last.estimate
        x, y, heading = (float(value) for value in estimate.pose)
        report.pose = x, y, heading
        std_x, std_y, std_heading = (float(value) for value in estimate.belief.std[:3])
        report.std = std_x, std_y, std_heading
        with contextlib.suppress(NomadError):
            if self.simulated:
                # Of a simulation only, and only while it is still connected.
                truth = self.robot.truth()
                report.truth = truth.x_in, truth.y_in, truth.steering_rad
        return report

    def save(self, options: argparse.Namespace) -> bool:
        """Save the estimate for --save; return False if that failed, which is printed on stderr."""
        estimate, state = self.controller.last
        encoders = (state.x_in, state.y_in, state.steering_rad)
        try:
            arguments.save_estimate(options, self.world, estimate, encoders, state.turret_rad)
        except NomadError as error:
            print(f"nomad: {error}", file=sys.stderr)
            return False
        return True


@contextlib.contextmanager
def open_mission(options: argparse.Namespace, map_name: str = "") -> Iterator[MissionContext]:
    """Connect to the robot and start localizing it; stop it at the end in any case."""
    # 1. Everything that can fail without a robot.
    world = arguments.resolve_world(options, map_name)
    arguments.check_writable(options.save, options.report)
    publisher = Publisher(options.publish) if options.publish else None
    # 2. Robot and filter.
    robot, simulated = arguments.open_robot(options.address)
    with robot, contextlib.closing(publisher) if publisher else contextlib.nullcontext():
        options.body = resolve_robot_model(options.body, robot.model.name, options.address)
        belief, config, sonars = arguments.prepare_localization(robot, simulated, world, options)
        body = resolve_body(options.body, options.model_file, options.address)
        waits = arguments.is_lockstep(options.address)
        with (
            filter_on_robot(
                options.method, config, belief, waits=waits, report=arguments.report_wait,
                alike=arguments.find_alike(world, config, belief),
            ) as method,
            RobotController(robot, config, body, belief, robot.sleep, method, options.speed) as controller,
        ):
            context = MissionContext(controller, robot, simulated, sonars, [], [], world)
            # 3. Observers.
            controller.observers.append(lambda observation: context.echoes.extend(observation.estimate.echoes))
            if publisher:
                progress = ProgressPublisher(publisher, GroundTruth(robot, simulated), context.goals)
                controller.observers.append(progress)
                progress(controller.last)
            yield context


def execute_mission(
    context: MissionContext, settings: Settings, act: Callable[[Mission], object], options: argparse.Namespace
) -> int:
    """Run a mission, write its report and save the estimate, however it ends; return the exit code."""
    mission = Mission(context.controller, settings)
    try:
        run_mission(mission, act)
    finally:
        try:
            write_report(context.complete_report(mission.report), options)
        finally:
            saved = context.save(options)
    return FAILED if not mission.report.done else ExitCode.DONE if saved else ExitCode.FAILED


def write_report(report: Report, options: argparse.Namespace) -> None:
    """Print a report, and write it to --report. Raises MissionFileError if that fails."""
    try:
        if options.report:
            with write_errors_as(MissionFileError, options.report, "the report"):
                options.report.write_text(json.dumps(report.as_json(), indent=1) + "\n", encoding="utf-8")
    finally:
        print(json.dumps(report.as_json()) if options.json else report.text(), flush=True)
