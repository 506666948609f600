"""Check a robot without moving it: link, firmware, sensors, bumpers, batteries, clock.

    nomad doctor nserver://localhost:7019/1
    nomad doctor "serial:///dev/ttyUSB0?model=n150" --exchanges 500 --json
    nomad doctor                                   no address, no NOMAD_ROBOT: look for a robot on all serial ports

The search asks each port that no other program uses for its state, at every usual baud rate, and then an Nserver on
this machine.

Prints a line for each finding, OK, WARN or FAIL, with a remedy. Exit code 1 if any finding is FAIL.
"""

import argparse
import contextlib
import json
import os
import shlex
import time
from typing import Final

from nclient.common.arguments import add_address, add_flag, add_value, seconds, whole_number
from nclient.common.process import ExitCode
from nclient.connector import DEFAULT_ADDRESS, VARIABLE, Connector, address_or_default, is_listening
from nclient.diagnostics import EXCHANGES, INTERVAL_S, Diagnostics, Finding, Grade, fail, ok, report, warn, worst
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.protocol.commands import BY_NAME
from nclient.protocol.decode import guess_model
from nclient.protocol.serial_framing import SerialFramer, build_frame
from nclient.protocol.types import Model
from nclient.transports import serial
from nclient.transports.stream import Deadline
from nclient.url import DEFAULT_PORT, parse_address

_GET_STATE: Final = BY_NAME["gs"].line_type or 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_address(parser, "the first robot found")
    count = whole_number("the number of exchanges", 1, 1_000_000)
    add_value(parser, "--exchanges", "N", count, f"send gs N times (default: {EXCHANGES})", EXCHANGES)
    add_value(parser, "--interval", "S", seconds,
              f"send gs at intervals of S seconds (default: {INTERVAL_S:g})", INTERVAL_S)
    add_flag(parser, "--json", "print one JSON object instead of lines")


def run(options: argparse.Namespace) -> int:
    """Check the robot, print the findings, and return the exit code."""
    if not options.address and not os.environ.get(VARIABLE):
        return _search(options)
    return _check(address_or_default(options.address), options)


def _check(address: str, options: argparse.Namespace, search: dict[str, object] | None = None) -> int:
    """Check one robot, print the findings, in JSON with those of a search before, and return the exit code."""
    connector = Connector(parse_address(address))
    chart = Diagnostics(connector.open_session, time.perf_counter, time.sleep).run(options.exchanges, options.interval)
    findings = report(chart)
    grade = worst(findings)
    if options.json:
        print(json.dumps({"address": address, "model": chart.model, "worst": grade.name, "findings": _dicts(findings)}
                         | (search or {})))
    else:
        for finding in findings:
            print(finding)
    return ExitCode.FAILED if grade is Grade.FAIL else ExitCode.DONE


def _dicts(findings: list[Finding]) -> list[dict[str, object]]:
    return [finding._asdict() | {"grade": finding.grade.name} for finding in findings]


# -- search -----------------------------------------------------------------------------------------------------------

USUAL_BAUDS: Final = (38400, 9600, 19200, 57600, 115200)
"""Baud rates that are tried, that of a Nomad as it was delivered first."""
ANSWER_S: Final = 0.4
"""Wait for an answer at each rate: a whole state packet of a N150 takes 0.06 s at 9600 baud."""
_QUIET_S: Final = 0.05


def _search(options: argparse.Namespace) -> int:
    """Look for robots on all ports and for an Nserver; check the Nserver if there is one, and return the exit code."""
    findings, found = [], []
    for port in serial.ports():
        finding, address = search_port(port)
        findings.append(finding)
        found += [address] if address else []
    if not findings:
        findings.append(warn("ports", "this machine has no serial ports", "is the adapter plugged in?"))
    is_nserver = is_listening("localhost", DEFAULT_PORT)
    if not found and not is_nserver:
        findings.append(fail(
            "robot", "none found", "switch it on, plug its cable in, and look at docs/real-robot.md; "
            f"for an Nserver elsewhere give its address, or start one: {DEFAULT_ADDRESS} does not answer"))
    if options.json and is_nserver:
        return _check(DEFAULT_ADDRESS, options, {"addresses": found, "ports": _dicts(findings)})
    if options.json:
        grade = Grade.OK if found else Grade.FAIL
        print(json.dumps({"addresses": found, "worst": grade.name, "findings": _dicts(findings)}))
    else:
        for finding in findings:
            print(finding)
        for address in found:
            print(f"      next: nomad doctor {shlex.quote(address)}")
    if is_nserver:
        return _check(DEFAULT_ADDRESS, options)
    return ExitCode.DONE if found else ExitCode.FAILED


def search_port(port: str) -> tuple[Finding, str]:
    """Ask a port at every usual baud rate for a Nomad's state, which moves nothing.

    Returns
    -------
    tuple of Finding and str
        What was found, and the address of the robot, "" without one.
    """
    # 1. A port that another program has open: to set its baud rate would disturb that program, lock or not.
    if users := ", ".join(serial.users(port)):
        return warn(port, f"not asked: in use by {users}", "end that program to look for a robot there"), ""
    # 2. Every rate.
    noisy = []
    for baud in USUAL_BAUDS:
        try:
            model, is_noisy = ask_port(port, baud)
        except ConnectionLost as error:
            return warn(port, "cannot be asked", str(error)), ""
        if model is not None:
            rate = "" if baud == serial.DEFAULT_BAUD else f"&baud={baud}"
            place = port if port.startswith("/") else f"/{port}"  # COM3: serial:///COM3
            return ok(port, f"a {model.name} answers at {baud} baud"), f"serial://{place}?model={model.name}{rate}"
        noisy += [baud] if is_noisy else []
    rates = ", ".join(map(str, USUAL_BAUDS))
    if noisy:
        return warn(port, f"answers at {', '.join(map(str, noisy))} baud, but not as a Nomad",
                    "another device, or a robot at an unusual rate: try baud= in the address"), ""
    return warn(port, f"silent at {rates} baud", "another device, or a robot that is off or not plugged in"), ""


def ask_port(port: str, baud: int) -> tuple[Model | None, bool]:
    """Return the model of the robot that answers at this baud rate, None without one, and whether bytes came at all.

    Raises
    ------
    ConnectionLost
        If the port cannot be opened.
    """
    stream, framer, is_noisy = serial.open_port(port, baud), SerialFramer(), False
    try:
        # 1. What was under way before is no answer. Another device may send without a pause.
        deadline = Deadline.after(ANSWER_S)
        with contextlib.suppress(ReplyTimeout):
            while deadline.remaining():
                stream.receive(Deadline.after(_QUIET_S))
        # 2. gs only reads the state.
        stream.send(build_frame(_GET_STATE))
        deadline = Deadline.after(ANSWER_S)
        with contextlib.suppress(ReplyTimeout):
            while deadline.remaining():
                data = stream.receive(deadline)
                is_noisy = True
                for frame in framer.receive(data):
                    if frame.type == _GET_STATE and (model := guess_model(frame.data)):
                        return model, True
    finally:
        stream.close()
    return None, is_noisy
