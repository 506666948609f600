"""Check rows of the command table that is generated for the C library."""

from __future__ import annotations

import pytest

from docs.generate import c_table
from nclient.protocol.commands import COMMANDS


def test_every_command_has_a_row() -> None:
    rows = [line for line in c_table.table().splitlines() if line.startswith("ROW(")]
    assert len(rows) == len(COMMANDS)
    # Types 12 and 5; "www" and "sss": three words over TCP, three signed 16-bit numbers on the line; models 7 = 1 + 2
    # + 4; time-out 1 s; no packet type.
    assert 'ROW(VM, "vm", 12, 5, "www", "sss", STATE, STATE, 7, 1, -1, "")' in rows
    assert 'ROW(ARM_WS, "arm_ws", 300, 128, "P", "P", SPECIAL, SPECIAL, 7, 30, 41, "uuL")' in rows
    # No type over TCP; a byte and an unsigned 16-bit number; models 6: all but the N200.
    assert 'ROW(CONF_SER, "conf_ser", -1, 35, "", "bu", STATE, STATE, 6, 1, -1, "")' in rows


def test_unknown_layout_raises_key_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c_table, "_LETTERS", {})
    with pytest.raises(KeyError):
        c_table.table()
