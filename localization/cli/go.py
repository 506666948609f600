"""Drive a robot to a place by the shortest way, around what the map does not have, on whatever address.

    nomad go "sim:several_walls?noisy=1&seed=3&start=5,5" --to 90,55
    nomad go nserver://localhost:7019/1 --map thesis_room --to 60,40,90

Says every second where it is, and at the end a report. Exit code 0: it is there; 3: it is not, and why.
Rules: reads options and prints; it is a mission of one step. The robot stands at the end, on an error and on Ctrl-C.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from math import degrees, inf

from localization.cli.driving import add_options, open_mission
from localization.cli.mission import carry_out
from localization.cli.options import numbers
from localization.missions.controller import Observation
from localization.missions.settings import LEAST_S, LEAST_WITHIN_IN, LONGEST_S, MOST_WITHIN_IN, OnLost, Settings
from localization.navigation.waypoints import STOP_RADIUS_IN

TELL_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `nomad go`."""
    parser.add_argument(
        "address", nargs="?", metavar="ADDRESS", help="the robot (default: NOMAD_ROBOT, or a local nserver)"
    )
    parser.add_argument("--to", type=_place, required=True, metavar="X,Y[,HEADING]", help="inches and degrees")
    parser.add_argument(
        "--within",
        type=_between(LEAST_WITHIN_IN, MOST_WITHIN_IN),
        default=STOP_RADIUS_IN,
        metavar="IN",
        help="it counts as reached within this (default %(default)s in)",
    )
    parser.add_argument(
        "--time-limit",
        type=_between(LEAST_S, LONGEST_S),
        default=300.0,
        metavar="S",
        help="give up after so many seconds of the robot's clock (default %(default)s)",
    )
    parser.add_argument(
        "--on-lost",
        choices=[policy.value for policy in OnLost],
        default=OnLost.STOP.value,
        help="what to do where the robot no longer knows where it is (default %(default)s)",
    )
    parser.set_defaults(report=None)
    add_options(parser)


def run(options: argparse.Namespace) -> int:
    """Do it; the exit code."""
    settings = Settings(time_limit_s=options.time_limit, on_lost=OnLost(options.on_lost))
    with open_mission(options) as out:
        if not options.json:
            out.controller.watchers.append(_Teller())
        out.goals.append(options.to[:2])
        return carry_out(out, settings, lambda robot: robot.go_to(*options.to, within_in=options.within), options)


class _Teller:
    """A line a second."""

    def __init__(self) -> None:
        self._told_s = -inf

    def __call__(self, sight: Observation) -> None:
        if sight.estimate.clock_s < self._told_s + TELL_S:
            return
        self._told_s = sight.estimate.clock_s
        x, y, heading = sight.estimate.pose
        std = sight.estimate.belief.std
        print(f"{self._told_s:7.1f} s  ({x:6.1f}, {y:6.1f}) in {degrees(heading):5.0f} deg"
              f"  ± {max(std[0], std[1]):.2f} in {degrees(std[2]):.1f} deg  {sight.estimate.health.status.value}",
              flush=True)  # fmt: skip


def _between(low: float, high: float) -> Callable[[str], float]:
    """Reads a number within the bounds of a mission."""

    def read(text: str) -> float:
        (number,) = numbers(text, 1)
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"a number from {low:g} to {high:g}, not {text}")
        return number

    return read


def _place(text: str) -> tuple[float, ...]:
    return tuple(numbers(text, 3 if text.count(",") == 2 else 2))
