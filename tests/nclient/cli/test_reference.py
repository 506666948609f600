"""Usage and help, of every row of the table."""

from __future__ import annotations

import pytest

from nclient import capi
from nclient.cli.shell_session import (
    _EXAMPLES,
    ParsedCommand,
    build_call,
    help_lines,
    model_note,
    parameters,
    parse,
    summaries,
    usage,
)
from nclient.protocol.commands import BY_NAME, COMMANDS
from nclient.protocol.types import MODELS, N150, SCOUT, serial_wire_state, tcp_wire_state


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row.name)
def test_every_command_has_help(row: object) -> None:
    (command,) = (known for known in COMMANDS if known is row)
    reported = list(help_lines(command.name, tcp_wire_state(N150)))
    assert reported[0] == usage(command)
    assert reported[1].strip() == command.summary
    assert f"robot.{command.method};" in reported[-1]


@pytest.mark.parametrize("name", [
    "pr", "vm", "sp", "ac", "pa", "mv", "st", "ws", "dp", "da", "conf_sn", "conf_ir", "conf_tm", "conf_ls",
    "connect_robot", "place_robot", "draw_line", "draw_arc", "arm_mv", "gs", "ct", "tk",
])  # fmt: skip
def test_as_many_arguments_as_the_c_call_has(name: str) -> None:
    declared = getattr(capi, name).__code__
    # connect_robot of the Python interface has optional arguments besides the robot number of the C call.
    wanted = 1 if name == "connect_robot" else declared.co_argcount
    assert len(parameters(BY_NAME[name])) == wanted


@pytest.mark.parametrize(("name", "lines"), [
    ("vm", ["translation  1/10 in/s", "steering     1/10 deg/s", "such as: vm 100 0 0"]),
    ("ac", ["turret       1/10 deg/s2"]),
    ("ws", ["translation  0 or 1", "timeout_s    s"]),
    ("pa", ["over TCP, on the serial line of n200"]),
    ("conf_ser", ["not over TCP, on the serial line of n150, scout"]),
    ("gs", ["robot.refresh; over TCP"]),
    ("sim_truth", ["over TCP, on no serial line"]),
])
def test_help_shows_units_and_availability(name: str, lines: list[str]) -> None:
    reported = "\n".join(help_lines(name, tcp_wire_state(N150)))
    assert all(line in reported for line in lines), reported


def test_a_robots_own_line_bounds_its_numbers() -> None:
    reported = "\n".join(help_lines("pr", serial_wire_state(N150)))
    assert "translation  1/10 in    -32767 to 32767" in reported
    assert "-32767" not in "\n".join(help_lines("pr", tcp_wire_state(N150)))


def test_a_scout_has_wheels() -> None:
    assert any("right wheel" in line for line in help_lines("vm", tcp_wire_state(SCOUT)))
    assert not any("wheel" in line for line in help_lines("vm", tcp_wire_state(N150)))
    assert "wheel" in model_note(SCOUT)
    assert "turret" in model_note(N150)


def test_the_list_has_what_there_is_with_this_robot() -> None:
    tcp, line = summaries(tcp_wire_state(N150)), summaries(serial_wire_state(MODELS["n200"]))
    assert len(tcp) == sum(row.tcp_type is not None for row in COMMANDS)
    assert "sim_truth" in tcp
    assert "sim_truth" not in line
    assert tcp["conf_sn rate order[16]"] == BY_NAME["conf_sn"].summary


@pytest.mark.parametrize("example", _EXAMPLES.values())
def test_examples_are_calls(example: str) -> None:
    (command,) = parse(example)
    assert isinstance(command, ParsedCommand)
    assert build_call(command, tcp_wire_state(N150), (), 1).name == example.split()[0]
