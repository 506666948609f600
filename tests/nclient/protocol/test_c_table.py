"""The C library's table is the one table: written anew it is the file that lies in the tree."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from nclient.protocol import c_table
from nclient.protocol.commands import COMMANDS

ROWS = Path(__file__).parents[3] / "clib" / "src" / "commands.inc"


def test_the_file_in_the_tree_is_up_to_date() -> None:
    assert c_table.written() == ROWS.read_text(), "run scripts/clib-table"


@pytest.mark.filterwarnings("ignore:.*found in sys.modules.*:RuntimeWarning")
def test_run_as_a_module_it_says_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_module("nclient.protocol.c_table", run_name="__main__")
    assert capsys.readouterr().out == ROWS.read_text()


def test_a_row_a_command() -> None:
    rows = [line for line in c_table.written().splitlines() if line.startswith("ROW(")]
    assert len(rows) == len(COMMANDS)
    assert 'ROW(VM, "vm", 12, 5, "www", "sss", STATE, STATE, 7, 1, -1, "")' in rows
    assert 'ROW(ARM_WS, "arm_ws", 300, 128, "P", "P", SPECIAL, SPECIAL, 7, 30, 41, "uuL")' in rows
    assert 'ROW(CONF_SER, "conf_ser", -1, 35, "", "bu", STATE, STATE, 6, 1, -1, "")' in rows


def test_what_a_row_cannot_say_is_no_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c_table, "_LETTERS", {})
    with pytest.raises(KeyError):
        c_table.written()
