"""`nomad map learn`: make a map of walls from a recorded drive."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from localization.cli import arguments
from localization.filters.sonar_cone import ConeSonar
from localization.live.plot import check_picture
from localization.mapping.learn import ROUGHNESS_IN, MapLearner
from localization.mapping.measurements import read_drive
from localization.mapping.output import LearnedMap, describe, draw_learned, summary
from nclient.common.arguments import add_value
from nclient.common.exit_codes import ExitCode
from nclient.common.files import write_errors_as
from nclient.errors import OutputFileError
from worlds.io import format_world, parse_world
from worlds.robots import format_calibration


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map learn`."""
    parser.description = (
        "Make a map of the room from a recorded drive: no map is needed. Record one with record=FILE in the address of "
        "a robot."
    )
    parser.epilog = "example: nomad map learn --from out/drive.log --out room.toml --picture out/room.png"
    parser.add_argument(
        "--from", dest="recording", type=Path, required=True, metavar="RECORDING", help="read this recording of a drive"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    add_value(parser, "--picture", "PNG", Path, "draw walls, echoes and path into this file (needs the extra `plot`)")
    add_value(parser, "--calibration-out", "FILE", Path,
              "write sonar offsets and wheel scales into this model file, which --calibration reads")
    arguments.add_odometry_noise(parser)
    add_value(parser, "--roughness", "IN", arguments.parse_positive,
              "standard deviation of walls from straight lines in in: 0.8 for a real building", ROUGHNESS_IN)
    arguments.add_sonar_model(parser)
    parser.add_argument("--json", action="store_true", help="print only the result, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code: 0, or 4 if the map does not hold together and is not written."""
    # 1. Report unwritable files before the work.
    arguments.check_writable(options.out, options.calibration_out)
    if options.picture is not None:
        check_picture(options.picture)
    # 2. The map.
    log = read_drive(options.recording)
    learner = MapLearner(
        log, options.odometry_noise, ConeSonar(), rays=options.sonars == "rays", roughness_in=options.roughness
    )
    while not learner.is_complete:
        learner.advance()
    learner.finish()
    found = describe(learner.estimate, learner.turret_rad)
    # 3. Results. The picture also shows why a map is refused.
    if options.picture is not None:
        draw_learned(options.picture, found, learner.estimate)
    reason = found.reason_to_refuse()
    if not reason:
        _write_files(options, found, log.model)
    print(json.dumps(found.as_json()) if options.json else summary(found))
    if reason:
        print(f"nomad map learn: no map written: {reason}", file=sys.stderr)
        return ExitCode.UNFIT
    return ExitCode.DONE


def _write_files(options: argparse.Namespace, found: LearnedMap, model: str) -> None:
    """Write the world file and the calibration."""
    comment = f"nomad map learn --from {options.recording.name}: {found.quality.explained:.0%} of the ranges explained"
    text = format_world(found.world(options.out.stem), comment)
    # Reading it again checks it as any other world file.
    parse_world(text, str(options.out), options.out.stem)
    _write(options.out, text)
    if options.calibration_out is not None:
        _write(options.calibration_out, format_calibration(model, found.calibration, comment))


def _write(path: Path, text: str) -> None:
    with write_errors_as(OutputFileError, path):
        path.write_text(text, encoding="utf-8")
