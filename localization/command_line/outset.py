"""What every command that localizes a robot begins with: its options, and from them the first belief.

    add_known()      what is known of the robot, for whoever hears its sonars
    add_options()    the same, and how it is to be localized
    outset()         where the robot is said to stand, what its sonars are taken for, what is believed of it

Rules: reads options, says on stdout (stderr with --json) what is guessed; what is driven is the command's.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import NamedTuple

from localization.command_line import resuming
from localization.command_line.readers import UNKNOWN, constants, noise, positive, stds
from localization.driving.navigation import Speeds
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import Belief, independent
from localization.filters.odometry import with_parameters
from localization.filters.registry import METHODS
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR
from localization.live.sensor_input import with_wheels
from localization.taken.sonars import Taken, taken
from nclient import Robot, RobotState
from worlds.bodies import BODIES
from worlds.calibration import FAULTLESS, Calibration, load_calibration
from worlds.world import World

START_STD = (0.1, 0.1, 0.01)
"""How well the robot is placed at the start: inches, inches, radians."""


class Outset(NamedTuple):
    """What is believed at the first state, of a robot in surroundings, and for what its sonars are taken."""

    belief: Belief
    known: LocalizationConfig
    sonars: Taken


def add_known(parser: argparse.ArgumentParser) -> None:
    """What is known of a robot: --body, --odometry-noise, --sonars."""
    parser.add_argument("--body", choices=sorted(BODIES),
                        help="the robot's model, where its address does not tell it (default n150)")
    parser.add_argument("--odometry-noise", type=noise, default=THESIS_ODOMETRY, metavar="A,B,C",
                        help="stds of what the encoders miss by chance: in after 1 in, rad after 1 rad, rad after 1 in "
                             f"(default {','.join(str(value) for value in astuple(THESIS_ODOMETRY))})")
    parser.add_argument("--sonars", choices=("rays", "cones"),
                        help="how readings are understood: exact rays (setups ideal and noisy) or a real ring's cones, "
                             "with bad readings among them (default: as the setup of a sim: address has them, rays of "
                             "other simulations, cones of a robot)")


def add_options(parser: argparse.ArgumentParser, method: str, method_help: str, publish_help: str) -> None:
    """What all these commands have; `method` is the one where none is given."""
    parser.add_argument("--start-std", type=stds, default=START_STD, metavar="X,Y,HEADING",
                        help="how well that is known, inches and degrees (default 0.1,0.1,0.57)")
    parser.add_argument("--speed", type=positive, default=Speeds().translation_in_s, metavar="IN_S",
                        help="top speed in in/s (default %(default)s)")
    add_known(parser)
    parser.add_argument("--scale-std", type=constants, default=(), metavar="A[,B[,C]]",
                        help="find out the encoders' own errors, so uncertain at first: share of the way, share of the "
                             "turn, drift in rad/in (default: none; 0.05 is a worn robot's)")
    parser.add_argument("--calibration", type=Path, metavar="FILE",
                        help="what this robot's wheels and sonars get wrong: a model file as nomad calibrate writes; "
                             "counts before --scale-std")
    parser.add_argument("--method", choices=METHODS, default=method, help=f"{method_help} (default {method})")
    parser.add_argument("--publish", metavar="URL",
                        help="show estimate and echoes on the page of `nserver --viewer`, at the address that it "
                             f"printed{publish_help}")
    resuming.add_arguments(parser)


def outset(robot: Robot, simulated: bool, world: World, options: argparse.Namespace) -> Outset:
    """Set the encoders where that is asked for, and say what is believed. Raises EstimateFileError, WorldFileError."""
    state = _placed(robot, robot.refresh(), options.start) if options.start else robot.refresh()
    errs = load_calibration(options.calibration, options.body) if options.calibration else FAULTLESS
    belief = resuming.belief(options, world, state) or _anew(options, state, errs)
    sonars = taken(options.sonars, simulated, options.address)
    if sonars.line():
        print(sonars.line(), file=sys.stderr if options.json else sys.stdout, flush=True)
    sonar = WIRE_SONAR if sonars.rays else ConeSonar()
    known = LocalizationConfig(world.walls, BODIES[options.body], options.odometry_noise, sonar, calibration=errs)
    return Outset(belief, known, sonars)


def _placed(robot: Robot, state: RobotState, start: Sequence[float] | str) -> RobotState:
    """The state after the encoders are set to where the robot stands, its turret against its body as it was."""
    if start == UNKNOWN:
        return state
    x, y, heading = map(float, start)
    robot.set_position(x_in=x, y_in=y)
    return robot.set_angles(steering_rad=heading, turret_rad=heading + state.turret_rad - state.steering_rad)


def _anew(options: argparse.Namespace, state: RobotState, errs: Calibration) -> Belief:
    here = independent([state.x_in, state.y_in, state.steering_rad], options.start_std)
    return with_wheels(here, errs) if options.calibration else with_parameters(here, options.scale_std)
