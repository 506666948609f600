"""Check a robot without moving it: link, firmware, sensors, bumpers, batteries, clock.

    nomad doctor nserver://localhost:7019/1
    nomad doctor "serial:///dev/ttyUSB0?model=n150" --exchanges 500 --json

Prints a line for each finding, OK, WARN or FAIL, with a remedy. Exit code 1 if any finding is FAIL.
"""

import argparse
import json
import time

from nclient.common.arguments import add_address, add_flag, add_value, seconds, whole_number
from nclient.common.exit_codes import ExitCode
from nclient.connector import Connector, address_or_default
from nclient.diagnostics import EXCHANGES, INTERVAL_S, Diagnostics, Grade, report, worst
from nclient.url import parse_address


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_address(parser)
    count = whole_number("the number of exchanges", 1, 1_000_000)
    add_value(parser, "--exchanges", "N", count, f"send gs N times (default {EXCHANGES})", EXCHANGES)
    add_value(parser, "--interval", "S", seconds,
              f"send gs at intervals of S seconds (default {INTERVAL_S:g})", INTERVAL_S)
    add_flag(parser, "--json", "print one JSON object instead of lines")


def run(options: argparse.Namespace) -> int:
    """Check the robot, print the findings, and return the exit code."""
    address = address_or_default(options.address)
    connector = Connector(parse_address(address))
    chart = Diagnostics(connector.open_session, time.perf_counter, time.sleep).run(options.exchanges, options.interval)
    findings = report(chart)
    grade = worst(findings)
    if options.json:
        print(json.dumps({"address": address, "model": chart.model, "worst": grade.name,
                          "findings": [finding._asdict() | {"grade": finding.grade.name} for finding in findings]}))
    else:
        for finding in findings:
            print(finding)
    return ExitCode.FAILED if grade is Grade.FAIL else ExitCode.DONE
