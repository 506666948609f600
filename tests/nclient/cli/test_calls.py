"""Calls of parsed commands: as C would send them; errors are raised before anything is sent."""

from __future__ import annotations

import pytest

from nclient.cli.shell_session import ParsedCommand, build_call, parse
from nclient.errors import ShellError, WireError
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING, N150, N200, WireState, serial_wire_state, tcp_wire_state

TCP = tcp_wire_state(N150)
PID = 4711


def call(text: str, wire_state: WireState = TCP) -> Call:
    (command,) = parse(text)
    assert isinstance(command, ParsedCommand)
    return build_call(command, wire_state, EVERYTHING.smask, PID)


@pytest.mark.parametrize(("text", "args"), [
    ("st", ()),
    ("pr 240 0 -5", (240, 0, -5)),
    ("pr 240.0 0 0", (240, 0, 0)),
    # The order has 16 entries. 255 ends it, and fills what is not typed.
    ("conf_sn 15 {0, 2, 15}", (15, 0, 2, 15, *[255] * 13)),
    ("conf_sn 15 0 2 255", (15, 0, 2, *[255] * 14)),
    ("conf_ir 4 " + " ".join(map(str, range(16))), (4, *range(16))),
    # The C call has no process number; the program adds its own.
    ("connect_robot 2", (2, PID)),
    ("ct", EVERYTHING.smask),
    ("ct {0 " + "0 1 " * 21 + "1}", (0, *[0, 1] * 21, 1)),
    ("tk good morning", ("good morning",)),
    ("special_request 200 1 2 3", (200, 1, 2, 3)),
    ("add_obstacle 3 0 0 100 0 0 100", (3, 0, 0, 100, 0, 0, 100)),
    # Typed as in C; the call holds thousandths of it.
    ("motion_check 0 0 0 400.5 0", (0, 0, 0, 400500.0, 0)),
])
def test_arguments_are_those_of_the_table(text: str, args: tuple[object, ...]) -> None:
    assert call(text).args == args


@pytest.mark.parametrize(("text", "reported"), [
    ("prr 1", "no command 'prr'; did you mean pr.?; help lists them all"),
    ("vn 1 0 0", "no command 'vn'; did you mean vm.; help"),
    ("smask", "no command 'smask'; did you mean Smask.; help"),
    ("hlep", "no command 'hlep'; did you mean help"),
    ("zzzzzz", "no command 'zzzzzz'; help lists them all"),
    ("conf_ser 1 9600", "there is no conf_ser over TCP"),
    ("pr 240", "pr takes 3 numbers, not 1: pr translation steering turret"),
    ("st 1", "st takes no numbers, not 1: st"),
    ("conf_sn 15", r"conf_sn takes 2 to 17 numbers, not 1: conf_sn rate order\[16\]"),
    ("pr {1 2 3}", "pr takes 3 numbers, not 3"),
    ("conf_sn {15} 0 1", "conf_sn takes 2 to 17 numbers"),
    ("pr a 0 0", "pr: expected a number, not 'a'"),
    ("pr 2.5 0 0", "pr: expected whole numbers .*not 2.5 0 0"),
    ("pr 1e999 0 0", "pr: expected finite numbers"),
    (f"pr {10**400} 0 0", "pr: expected finite numbers of at most 64 bits, not 1000"),
    (f"motion_check 0 -{10**400} 0 0 0", "motion_check: expected finite numbers"),
    ("ct 1 2 3", "ct: a mask has 44 numbers, not 3"),
])
def test_invalid_calls_are_reported(text: str, reported: str) -> None:
    with pytest.raises(ShellError, match=reported):
        call(text)


@pytest.mark.parametrize(("text", "wire_state"), [
    # A number beyond 32 bits, a missing vertex, an unknown type, a number beyond the serial line's 16 bits.
    ("pr 99999999999 0 0", TCP),
    ("add_obstacle 3 0 0", TCP),
    ("motion_check 2 0 0 0 0", TCP),
    ("pr 40000 0 0", serial_wire_state(N150)),
])
def test_numbers_that_cannot_be_sent_are_the_wires_to_refuse(text: str, wire_state: WireState) -> None:
    with pytest.raises(WireError):
        call(text, wire_state)


def test_a_robots_own_line_has_commands_of_its_own() -> None:
    assert call("conf_ser 1 9600", serial_wire_state(N150)).args == (1, 9600)
    with pytest.raises(
        ShellError, match=r"no sim_truth .* n200.*help sim_truth"
    ):
        call("sim_truth", serial_wire_state(N200))
    with pytest.raises(ShellError, match=r"no pa .* n150"):
        call("pa 0 0 0", serial_wire_state(N150))
