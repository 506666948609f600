"""Drive a robot to a position by the shortest path, around obstacles that are not in the map.

    nomad go "sim:several_walls?noisy=1&seed=3&start=5,5" --to 90,55
    nomad go nserver://localhost:7019/1 --map thesis_room --to 60,40,90

Prints the estimate every second, and a report at the end. Exit code 0: reached; 3: not reached. It is a mission of one
step; the robot is stopped at the end, after errors and on Ctrl-C.
"""

import argparse
from collections.abc import Callable
from math import degrees, inf

from localization.cli.arguments import parse_numbers
from localization.cli.mission import add_mission_options, execute_mission, open_mission
from localization.navigation.controller import Observation
from localization.navigation.mission_settings import (
    MAX_TIME_S,
    MAX_WITHIN_IN,
    MIN_TIME_S,
    MIN_WITHIN_IN,
    OnLost,
    Settings,
)
from localization.navigation.waypoints import STOP_RADIUS_IN
from nclient.common.arguments import add_address, add_value, number

# Seconds of the robot's clock between two printed estimates.
PRINT_INTERVAL_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad go`."""
    add_address(parser)
    parser.add_argument(
        "--to",
        type=_parse_goal,
        required=True,
        metavar="X,Y[,HEADING]",
        help="drive to this position, inches and degrees",
    )
    add_value(parser, "--within", "IN", _number_between(MIN_WITHIN_IN, MAX_WITHIN_IN),
              "accept positions within this many inches", STOP_RADIUS_IN)
    add_value(parser, "--time-limit", "S", _number_between(MIN_TIME_S, MAX_TIME_S),
              "give up after this many seconds of the robot's clock", 300.0)
    parser.add_argument("--on-lost", choices=[policy.value for policy in OnLost], default=OnLost.STOP.value,
                        help="select the behaviour when the robot is lost (default: %(default)s)")  # fmt: skip
    parser.set_defaults(report=None)
    add_mission_options(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    # A mission of one step, go_to.
    settings = Settings(time_limit_s=options.time_limit, on_lost=OnLost(options.on_lost))
    with open_mission(options) as context:
        if not options.json:
            context.controller.observers.append(_ProgressPrinter())
        context.goals.append(options.to[:2])
        return execute_mission(
            context, settings, lambda robot: robot.go_to(*options.to, within_in=options.within), options
        )


class _ProgressPrinter:
    """Observer that prints the estimate once per second."""

    def __init__(self) -> None:
        self._printed_s = -inf

    def __call__(self, observation: Observation) -> None:
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
