"""The commands that drive to goals: `nomad go`, and `nomad mission` with several steps."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Callable, Iterator
from math import degrees, inf
from pathlib import Path
from typing import Final, NamedTuple

from localization.cli import arguments
from localization.cli.arguments import parse_numbers
from localization.live.assumptions import SonarAssumption, resolve_body, resolve_robot_model, sonar_mismatch_hint
from localization.live.background_search import filter_on_robot
from localization.live.estimate import Echo
from localization.live.run import GroundTruth, Publisher
from localization.navigation import pilot
from localization.navigation.mission import Mission, Report, run_mission
from localization.navigation.mission_steps import load_mission
from localization.navigation.waypoints import STOP_RADIUS_IN
from nclient import NomadError, Robot
from nclient.cli.serving import print_message
from nclient.common.arguments import add_address, add_flag, add_value, number
from nclient.common.files import write_errors_as
from nclient.common.process import ExitCode
from nclient.errors import MissionFileError
from worlds.io import load_world
from worlds.world import World

METHOD: Final = "finder"
"""Default filter: it detects when it is lost."""
# Exit code 3, as of other commands that ran and did not succeed.
FAILED: Final = ExitCode.NOT_REACHED


class MissionCommand:
    """Run a mission, a Python program or a list of steps in TOML.

        nomad mission docs/missions/rounds.toml "sim:several_walls?noisy=1&seed=3&start=5,5"
        nomad mission docs/missions/look_around.py nserver://localhost:7019/1 --map several_walls --report r.json

    Exit code 0: completed; 3: a step failed. The robot is stopped at the end, after errors and on Ctrl-C, and the
    report is written in all cases.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of `nomad mission`."""
        parser.add_argument("file", metavar="FILE", help="mission file, .toml or .py (docs/missions.md)")
        add_address(parser)
        add_flag(parser, "--check", "check the file and its map, report errors, move nothing")
        add_value(parser, "--report", "JSON", Path, "write the report to this file")
        add_mission_options(parser)

    @staticmethod
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


def add_mission_options(parser: argparse.ArgumentParser) -> None:
    """Add the options shared by `nomad mission` and `nomad go`."""
    arguments.add_map_option(parser, "that of the mission, or ")
    add_value(parser, "--start", "X,Y,HEADING", arguments.parse_pose,
              "set the encoders to this initial pose, inches and degrees (default: keep them)")
    arguments.add_localization_options(parser, METHOD, "filter; only finder detects that it is lost", "")
    add_flag(parser, "--json", "print only the report, as JSON, on stdout")


class MissionContext(NamedTuple):
    """A controlled robot and what its mission's report and page need."""

    controller: pilot.RobotController
    robot: Robot
    has_truth: bool
    """True if the robot has a true pose, in the frame of the map."""
    sonars: SonarAssumption
    echoes: list[Echo]
    goals: list[pilot.Point]
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
            if self.has_truth:
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
            print_message(str(error))
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
            filter_on_robot(options.method, config, belief, waits=waits, report=print_message,
                            alike=arguments.find_alike(world, config, belief)) as method,
            pilot.RobotController(robot, config, body, belief, robot.sleep, method, options.speed) as controller,
        ):
            first = GroundTruth(robot, simulated).first
            has_truth = simulated and not arguments.has_own_frame(options, world, belief, first)
            context = MissionContext(controller, robot, has_truth, sonars, [], [], world)
            # 3. Observers.
            controller.observers.append(lambda observation: context.echoes.extend(observation.estimate.echoes))
            if publisher:
                progress = pilot.ProgressPublisher(publisher, GroundTruth(robot, has_truth), context.goals)
                controller.observers.append(progress)
                progress(controller.last)
            yield context


def execute_mission(context: MissionContext, settings: pilot.Settings, act: Callable[[Mission], object],
                    options: argparse.Namespace) -> int:
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


# Seconds of the robot's clock between two printed estimates.
PRINT_INTERVAL_S = 1.0


class GoCommand:
    """Drive a robot to a position by the shortest path, around obstacles that are not in the map.

        nomad go "sim:several_walls?noisy=1&seed=3&start=5,5" --to 90,55
        nomad go nserver://localhost:7019/1 --map thesis_room --to 60,40,90

    Prints the estimate every second, and a report at the end. Exit code 0: reached; 3: not reached. It is a mission of
    one step; the robot is stopped at the end, after errors and on Ctrl-C.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of `nomad go`."""
        add_address(parser)
        parser.add_argument("--to", type=_parse_goal, required=True, metavar="X,Y[,HEADING]",
                            help="drive to this position, inches and degrees")  # fmt: skip
        add_value(parser, "--within", "IN", _number_between(pilot.MIN_WITHIN_IN, pilot.MAX_WITHIN_IN),
                  "accept positions within this many inches", STOP_RADIUS_IN)
        add_value(parser, "--time-limit", "S", _number_between(pilot.MIN_TIME_S, pilot.MAX_TIME_S),
                  "give up after this many seconds of the robot's clock", 300.0)
        parser.add_argument("--on-lost", choices=[policy.value for policy in pilot.OnLost],
                            default=pilot.OnLost.STOP.value,
                            help="select the behaviour when the robot is lost (default: %(default)s)")  # fmt: skip
        parser.set_defaults(report=None)
        add_mission_options(parser)

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Run the command and return its exit code."""
        # A mission of one step, go_to.
        settings = pilot.Settings(time_limit_s=options.time_limit, on_lost=pilot.OnLost(options.on_lost))
        with open_mission(options) as context:
            if not options.json:
                context.controller.observers.append(_ProgressPrinter())
            context.goals.append(options.to[:2])
            return execute_mission(context, settings, lambda robot: robot.go_to(*options.to, within_in=options.within),
                                   options)


class _ProgressPrinter:
    """Observer that prints the estimate once per second."""

    def __init__(self) -> None:
        self._printed_s = -inf

    def __call__(self, observation: pilot.Observation) -> None:
        estimate = observation.estimate
        if estimate.clock_s < self._printed_s + PRINT_INTERVAL_S:
            return
        self._printed_s = estimate.clock_s
        # Shown in inches and degrees; the larger of both standard deviations stands for the position.
        x, y, heading = estimate.pose
        std = estimate.belief.std
        print(f"{self._printed_s:7.1f} s  ({x:6.1f}, {y:6.1f}) in {degrees(heading):5.0f} deg"
              f"  ± {max(std[0], std[1]):.2f} in {degrees(std[2]):.1f} deg  {estimate.health.status.value}",
              flush=True)  # fmt: skip


def _number_between(low: float, high: float) -> Callable[[str], float]:
    return number(f"expected a number from {low:g} to {high:g}", low, high)


def _parse_goal(text: str) -> tuple[float, ...]:
    # The heading is optional: two commas mean three numbers.
    return tuple(parse_numbers(text, 3 if text.count(",") == 2 else 2))
