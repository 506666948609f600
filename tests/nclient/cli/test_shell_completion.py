"""Completion of shell lines: names that exist for this robot, at their place."""

from __future__ import annotations

import pytest

from nclient.cli import shell_session, state_text
from nclient.protocol.types import N150, serial_wire_state, tcp_wire_state

TCP = tcp_wire_state(N150)


def words(text: str) -> list[str]:
    return [candidate.word for candidate in shell_session.candidates(text, TCP)]


@pytest.mark.parametrize(("text", "found"), [
    ("get_s", ["get_sn", "get_sg"]),
    # Names of all commands, in the order of the table.
    ("  con", ["connect_robot", "conf_ir", "conf_sn", "conf_cp", "conf_ls", "conf_tm", "conf_sg"]),
    ("st", ["state", "st"]),
    ("pr 240 0 0; get_rp", ["get_rpx"]),
    ("Sma", ["Smask"]),
    ("help new", ["new_world"]),
    ("help Sma", []),
    ("state so", ["sonar"]),
    ("pr ", []),
    ("pr(", []),
    ("zzz", []),
])
def test_names_that_fit(text: str, found: list[str]) -> None:
    assert words(text) == found


def test_parts_of_the_state_are_offered_once() -> None:
    assert words("state ") == list(state_text.PARTS)
    assert words("state pose sonar ") == [part for part in state_text.PARTS if part not in ("pose", "sonar")]


def test_each_comes_with_what_it_is_for() -> None:
    (candidate,) = shell_session.candidates("get_sn", TCP)
    assert candidate.about == "ask for the sonars"


# conf_ser exists on a serial line of a N150 only, and sim_truth on none.
def test_only_what_this_robot_has() -> None:
    on_line = [candidate.word for candidate in shell_session.candidates("", serial_wire_state(N150))]
    assert "conf_ser" in on_line
    assert "conf_ser" not in words("")
    assert "sim_truth" not in on_line


@pytest.mark.parametrize(("text", "reported"), [
    ("pr 240", "pr translation steering turret"), ("pr", "pr translation steering turret"),
    ("st; conf_sn(15, ", "conf_sn rate order[16]"), ("sleep ", "sleep SECONDS"), ("", ""), ("zzz 1", ""),
])
def test_a_hint_is_the_usage_of_what_is_typed(text: str, reported: str) -> None:
    assert shell_session.hint(text) == reported
