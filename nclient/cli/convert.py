"""Convert recordings to and from MCAP, ROS bags, CARMEN logs and CSV; formats by suffix.

    nomad convert run.log run.mcap        ROS 2 messages, for Foxglove and ROS tools; back gives the same recording
    nomad convert run.mcap run.log        .bag: ROS 1; a name without suffix: the folder of a ROS 2 bag
    nomad convert run.log run.csv         time series, as nomad localize --from reads it; .clf: CARMEN log
    nomad convert flight.bag flight.csv --field x_m=/state:raw.0 --field y_m=/state:raw.1

What a format cannot hold is named on stderr. `replay:FILE` takes all of these files as an address.
"""

import argparse
import sys
from pathlib import Path

from nclient.common.process import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("source", type=Path, metavar="FROM", help="file to read, recognized by its content")
    parser.add_argument("target", type=Path, metavar="TO",
                        help="file to write: .log .mcap .bag .csv .clf, or without suffix a ROS 2 bag")
    parser.add_argument("--field", action="append", default=[], metavar="COLUMN=TOPIC:PLACE",
                        help="read a number of another type of message, such as sonar_0_m=/ranges:raw.0; columns x_m, "
                        "y_m, heading_rad or qx qy qz qw, sonar_0_m ...; repeatable")


def run(options: argparse.Namespace) -> int:
    """Convert a file, and return the exit code."""
    from nclient.recording import convert  # here: completion and help need no formats
    from nclient.recording.format import escape_controls

    # The target first: a mistake there must not cost the time to read a long file.
    convert.format_to_write(options.target)
    drive = convert.read_drive(options.source, options.field)
    convert.write_drive(drive, options.target)
    for omitted in drive.omitted:
        print(f"nomad: left out: {escape_controls(omitted)}", file=sys.stderr)
    first, last = drive.samples[0].time_s, drive.samples[-1].time_s
    print(f"{options.target}: {len(drive.samples)} samples, {last - first:.1f} s")
    return ExitCode.DONE
