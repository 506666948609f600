"""Compare docs/protocol.md with the command table and with known frames, and run its commands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from nclient.cli import main
from nclient.protocol.commands import COMMANDS

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
TCP, _, LINE = PAGE.partition("## On a serial line")


def cells(section: str, name: str) -> list[str]:
    (row,) = re.findall(rf"^\| `{name}` \|(.*)\|$", section, re.MULTILINE)
    return [cell.strip() for cell in row.split("|")]



def test_every_command_has_a_row() -> None:
    for section, kind in ((TCP, "tcp_type"), (LINE, "line_type")):
        named = re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
        assert named == [row.name for row in COMMANDS if getattr(row, kind) is not None]


@pytest.mark.parametrize(("section", "name", "wanted"), [
    # Rows in which the types, the layouts and the models were looked up by hand.
    (TCP, "vm", ["12", "translation, steering, turret", "a *state*", "80"]),
    (TCP, "disconnect_robot", ["103", "robot_id, pid", "none", "—"]),
    (TCP, "conf_sn", ["23", "rate, order[16]", "a *state*", "80"]),
    (TCP, "get_sn", ["28", "—", "State[17..32], [stamps], clock", "84"]),
    (TCP, "draw_line", ["61", "x1, y1, x2, y2, mode", "word", "82"]),
    (TCP, "move_obstacle", ["52", "n, x1, y1 .. xn, yn, dx, dy", "words", "82"]),
    (LINE, "vm", ["5", "all", "translation s16, steering s16, turret s16", "a *state*", "1"]),
    (LINE, "conf_ser", ["35", "N150, Scout", "port u8, baud u16", "a *state*", "1"]),
    (LINE, "get_sn", ["20", "all", "—", "State[17..32]: 16 x u8, [stamps], clock", "1"]),
    (LINE, "conf_cp", ["16", "N200", "mode u8", "3 x u8", "1"]),
    (LINE, "get_ra", ["23", "all", "—", "nothing", "1"]),
])
def test_rows_of_known_frames(section: str, name: str, wanted: list[str]) -> None:
    assert cells(section, name) == wanted


def test_commands_of_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for command in block.splitlines():
        assert main.main(shlex.split(command)[1:]) == 0
    assert capsys.readouterr().out.split() == [
        # vm 100 -50 0 over TCP and on the line: the frames of the page's examples.
        "000c0003" "00000064" "ffffffce" "00000000", "01080005640032800000245c",
    ]
