"""`nomad localize --from LOG.csv`: run a filter over a recorded drive of any robot."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from localization.cli.arguments import START_STD, UNKNOWN, check_writable
from localization.filters.base import LocalizationConfig, with_wall_errors
from localization.filters.belief import POSE, independent
from localization.filters.odometry import with_parameters
from localization.filters.registry import make
from localization.filters.sonar_cone import ConeSonar, building_sonar, cone_sonar
from localization.filters.sonar_ray import RaySonar, ray_sonar
from localization.live.assumptions import BUILDING_SETUP, resolve_body
from localization.live.log import read_log, run_log, without_echo
from localization.live.run import Run
from nclient.common.exit_codes import ExitCode
from nclient.recording import convert
from worlds.io import load_world
from worlds.rings import Ring
from worlds.robots import N150, Body, load_bodies

REPLAY: Final = "replay:"
ROBOT_OPTIONS: Final = ("address", "waypoints", "path", "publish", "save", "resume", "calibration", "stay")
"""Options of `nomad localize` that need a robot."""


SONARS: Final[Mapping[str, Callable[[Ring], RaySonar | ConeSonar]]] = MappingProxyType(
    {"rays": ray_sonar, "cones": cone_sonar, BUILDING_SETUP: building_sonar}
)
"""The sonar models by their names in --sonars."""


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add --from and --estimates."""
    parser.add_argument("--from", dest="log", type=Path, metavar="LOG",
                        help="localize a recorded drive instead of a robot: a recording, bag, MCAP or CARMEN log as "
                             "nomad convert reads them, or CSV with columns time_s, x_in, y_in, heading_deg, "
                             "sonar_0_in ... (page Real data of the manual)")  # fmt: skip
    parser.add_argument("--estimates", type=Path, metavar="FILE.csv",
                        help="with --from: write the estimate at each row, inches and degrees")  # fmt: skip


def take_replayed_drive(options: argparse.Namespace) -> None:
    """Make `--from FILE` of the address `replay:FILE`, if the file has a drive without the bytes of a recording.

    Such a file has readings and no instants of firing, which a filter on a live robot knows.
    """
    if not (options.address or "").startswith(REPLAY):
        return
    file = Path(options.address.removeprefix(REPLAY).partition("?")[0])
    if convert.may_be_drive(file, or_csv=True) and not convert.read_drive(file).traffic:
        options.address, options.log = None, file


def localize_recorded(options: argparse.Namespace) -> int:
    """Run `nomad localize --from`; return the exit code.

    Raises
    ------
    LogFileError, WorldFileError, OutputFileError
    """
    # 1. Everything that can fail.
    for name in ROBOT_OPTIONS:
        if getattr(options, name):
            option = name.upper() if name == "address" else f"--{name}"
            options.refuse(f"--from localizes a recorded drive: leave {option} out")
    if not options.map:
        options.refuse("a map is required: --map WORLD, a shipped world or a TOML file")
    if options.start == UNKNOWN:
        options.refuse(f"--start {UNKNOWN} needs a robot: give the pose at the first row of the log")
    world, body = load_world(options.map), _body(options)
    check_writable(options.estimates, options.picture)
    if options.picture:
        from localization.live.plot import check_picture

        check_picture(options.picture)
    rows = without_echo(read_log(options.log), body.ring)
    # 2. Initial belief and models.
    belief = independent(options.start or rows[0].odometry, options.start_std or START_STD)
    belief = with_parameters(belief, options.scale_std)
    sonar = with_wall_errors(SONARS[options.sonars or BUILDING_SETUP](body.ring), world)
    config = LocalizationConfig(world.walls, body, options.odometry_noise, sonar)
    # 3. Run, results.
    done = run_log(rows, body.ring.round_s, make(options.method, config, belief))
    if options.estimates:
        options.estimates.write_text(_table(done), encoding="utf-8")
    if options.picture:
        from localization.live.plot import draw_run

        draw_run(options.picture, world, done, body)
    print(json.dumps(done.summary()) if options.json else done.verdict(), flush=True)
    return ExitCode.DONE


def _body(options: argparse.Namespace) -> Body:
    """Return the robot of the log: --body, or the last model of --model-file, or an N150."""
    name = options.body
    if not name:
        name = [*load_bodies(options.model_file)][-1] if options.model_file else N150.name
    return resolve_body(name, options.model_file, None)


def _table(done: Run) -> str:
    """Return the estimates as CSV."""
    lines = ["time_s,x_in,y_in,heading_deg,x_std_in,y_std_in,heading_std_deg,health"]
    for moment in done.moments:
        estimate = moment.estimate
        (x, y, heading), std = estimate.pose.tolist(), estimate.belief.std[:POSE].tolist()
        numbers = (estimate.clock_s, x, y, math.degrees(heading), std[0], std[1], math.degrees(std[2]))
        lines.append(",".join([*(f"{number:.4f}" for number in numbers), estimate.health.status.value]))
    return "\n".join(lines) + "\n"
