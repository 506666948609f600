"""Examine a robot without moving it: link, firmware, sensors, bumpers, batteries, clock.

    nomad doctor nserver://localhost:7019/1
    nomad doctor "serial:///dev/ttyUSB0?model=n150" --exchanges 500 --json

A line for each finding, OK, WARN or FAIL, with what to do about it. Exit code 1 where anything is FAIL.

Rules: options and printing only; the questions are nclient.diagnostics's, what they mean is report.py's.
"""

from __future__ import annotations

import argparse
import json
import time

from nclient.common.arguments import seconds
from nclient.common.exit_codes import ExitCode
from nclient.connect import Connector, address_or_default
from nclient.diagnostics import EXCHANGES, INTERVAL_S, Diagnostics, Finding, Grade, report, worst
from nclient.url import parse_address


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """An address, how much is asked, and in what form it is told."""
    parser.add_argument("address", nargs="?", metavar="ADDRESS",
                        help="such as nserver://localhost:7019/1, serial:///dev/ttyUSB0 or sim:thesis_room (default: "
                             "NOMAD_ROBOT, or a local nserver's robot 1)")
    parser.add_argument("--exchanges", type=_count, default=EXCHANGES, metavar="N",
                        help=f"how often gs is asked (default {EXCHANGES})")
    parser.add_argument("--interval", type=seconds, default=INTERVAL_S, metavar="S",
                        help=f"seconds from one to the next (default {INTERVAL_S:g})")
    parser.add_argument("--json", action="store_true", help="print one object instead of lines")


def run(options: argparse.Namespace) -> int:
    """Examine and tell; the exit code."""
    address = address_or_default(options.address)
    connector = Connector(parse_address(address))
    chart = Diagnostics(connector.open_session, time.perf_counter, time.sleep).run(options.exchanges, options.interval)
    findings = report(chart)
    grade = worst(findings)
    if options.json:
        print(json.dumps({"address": address, "model": chart.model, "worst": grade.name,
                          "findings": [_as_object(finding) for finding in findings]}))
    else:
        for finding in findings:
            print(finding)
    return ExitCode.FAILED if grade is Grade.FAIL else ExitCode.DONE


def _as_object(finding: Finding) -> dict[str, str]:
    return {"grade": finding.grade.name, "what": finding.what, "seen": finding.seen, "remedy": finding.remedy}


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or not 1 <= int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f"1 to 1000000 exchanges, not {text}")
    return int(text)
