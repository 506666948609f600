"""Run a mission: a program in Python or a list of steps in TOML, on whatever address.

    nomad mission docs/missions/rounds.toml "sim:several_walls?noisy=1&seed=3&start=5,5"
    nomad mission docs/missions/look_around.py nserver://localhost:7019/1 --map several_walls --report r.json

Exit code 0: all was done; 3: a step failed. The robot stands at the end, on an error and on Ctrl-C, and the report is
told all the same. Rules: reads options, prints, writes the report; what is done is the file's.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

from localization.cli.driving import MissionContext, add_options, open_mission
from localization.missions.mission import Mission, run_mission
from localization.missions.report import Report
from localization.missions.settings import Settings
from localization.missions.steps import load_mission
from nclient.common.exit_codes import ExitCode
from nclient.common.files import describe_write_error
from nclient.errors import MissionFileError
from worlds.io import load_world

FAILED = ExitCode.NOT_REACHED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `nomad mission`."""
    parser.add_argument("file", metavar="FILE", help="the mission, .toml or .py (docs/missions.md)")
    parser.add_argument(
        "address", nargs="?", metavar="ADDRESS", help="the robot (default: NOMAD_ROBOT, or a local nserver)"
    )
    parser.add_argument(
        "--check", action="store_true", help="read the file and its map, say what is wrong with them, move nothing"
    )
    parser.add_argument("--report", type=Path, metavar="JSON", help="write the report there")
    add_options(parser)


def run(options: argparse.Namespace) -> int:
    """Do it; the exit code."""
    orders = load_mission(options.file)
    if options.map:
        load_world(options.map)
    else:
        orders.check_map()
    if options.check:
        print(f"{options.file}: a mission{f', {orders.settings.title}' if orders.settings.title else ''}")
        return 0
    with open_mission(options, orders.settings.map) as out:
        return carry_out(out, orders.settings, orders.run, options)


def carry_out(
    out: MissionContext, settings: Settings, act: Callable[[Mission], object], options: argparse.Namespace
) -> int:
    """Act as a mission; however that ends, its report is told and what is believed is kept. The exit code."""
    mission = Mission(out.controller, settings)
    try:
        run_mission(mission, act)
    finally:
        try:
            tell(out.close(mission.report), options)
        finally:
            kept = out.keep(options)
    return FAILED if not mission.report.done else ExitCode.DONE if kept else ExitCode.FAILED


def tell(report: Report, options: argparse.Namespace) -> None:
    """Print a report, and write it where that is asked for. Raises MissionFileError where that cannot be."""
    try:
        _write(report, options)
    finally:
        print(json.dumps(report.as_json()) if options.json else report.text(), flush=True)


def _write(report: Report, options: argparse.Namespace) -> None:
    if options.report:
        try:
            options.report.write_text(json.dumps(report.as_json(), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise MissionFileError(describe_write_error(options.report, error, "the report")) from error
