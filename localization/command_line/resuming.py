"""The options by which one run goes on from another: --save, --resume, --moved-std.

Rules: reads options and hands on; what still holds is kept.py's to say, the file is kept_file.py's.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from localization.filters.belief import Belief
from localization.filters.health import HealthStatus
from localization.filters.odometry import LARGEST, POSE, with_parameters
from localization.keeping import kept_file
from localization.keeping.kept import Kept, Moved, resumed, site_of
from localization.live.localizer import Estimate
from localization.live.sensor_input import EncoderPose
from localization.runs.run import Run
from nclient.errors import EstimateFileError
from nclient.robot_state import RobotState
from worlds.world import World


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The three options."""
    parser.add_argument("--save", type=Path, metavar="FILE", help="write down at the end what is believed of the pose")
    parser.add_argument("--resume", type=Path, metavar="FILE",
                        help="go on from what --save wrote, of the same robot on the same map; refused where the "
                             "encoders were set or the robot was switched off meanwhile")
    parser.add_argument("--moved-std", type=_moved, metavar="X,Y,HEADING",
                        help="with --resume: how far the robot may have been moved meanwhile without its encoders' "
                             "telling, inches and degrees (0,0,0: it stood)")  # fmt: skip


def belief(options: argparse.Namespace, world: World, state: RobotState) -> Belief | None:
    """What is believed at the first state of a run that goes on; None where it begins anew.

    Raises EstimateFileError.
    """
    if options.resume is None:
        if options.moved_std is not None:
            raise EstimateFileError("--moved-std says more of --resume FILE, which is not given")
        return None
    if options.start:
        raise EstimateFileError("--start begins anew and --resume goes on: give one of them")
    old = kept_file.load(options.resume)
    pose = np.array([state.x_in, state.y_in, state.steering_rad])
    now = EncoderPose(state.clock_s or 0.0, pose, state.turret_rad)
    held = resumed(old, site_of(world, options.body), now, options.odometry_noise, options.moved_std)
    known = len(held.mean) - POSE
    return with_parameters(held, options.scale_std[known:])


def save(options: argparse.Namespace, world: World, done: Run) -> None:
    """Write the end of a run down where that is asked for: pose and wheels, not what a method knows besides.

    Raises EstimateFileError, for a lost estimate too.
    """
    last = done.moments[-1]
    keep(options, world, last.estimate, last.odometry, last.turret_rad)


def keep(
    options: argparse.Namespace, world: World, estimate: Estimate, odometry: tuple[float, float, float],
    turret_rad: float,
) -> None:  # fmt: skip
    """Write an estimate down, and what the encoders say with it; as `save`."""
    if options.save is None:
        return
    if estimate.health.status is HealthStatus.LOST:
        raise EstimateFileError(f"{options.save}: not written, the estimate is lost: {estimate.health.reason}")
    encoders = EncoderPose(estimate.clock_s, np.array(odometry), turret_rad)
    known = Belief(estimate.belief.mean[:LARGEST], estimate.belief.cov[:LARGEST, :LARGEST])
    kept_file.save(options.save, Kept(site_of(world, options.body), encoders, known))


def _moved(text: str) -> Moved:
    try:
        x, y, heading_deg = (float(part) for part in text.split(","))
    except ValueError:
        x = y = heading_deg = math.nan
    if not all(0.0 <= number < math.inf for number in (x, y, heading_deg)):
        raise argparse.ArgumentTypeError(f"three numbers of 0 or more with commas between them, not {text!r}")
    return x, y, math.radians(heading_deg)
