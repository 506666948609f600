"""Drawing commands over the wire, and what they leave to be read out."""

from __future__ import annotations

import pytest

from nserver_emu.server.graphics import Figure
from nserver_emu.server.handlers.graphics import REFRESHERS
from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import meet, simulation


def test_there_are_ten_refresh_commands() -> None:
    assert len(REFRESHERS) == 10


@pytest.mark.parametrize("name", REFRESHERS)
def test_a_refresh_is_acknowledged_and_loses_nothing(name: str) -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    client.ask("draw_line", 0, 0, 10, 10, 1)
    assert client.ask(name).values == (0,)
    assert len(emulator.graphics.shapes) == 1


def test_shapes_are_in_drawing_order() -> None:
    emulator = Emulator(simulation())
    first, _ = meet(emulator)
    second, _ = meet(emulator)
    first.ask("draw_line", 1, 2, 3, 4, 2)
    second.ask("draw_arc", -10, 20, 30, 40, 0, 3600, 1)
    first.ask("draw_robot", 5, 6, 70, 80, 3)
    shapes = emulator.graphics.shapes
    assert [shape.figure for shape in shapes] == [Figure.LINE, Figure.ARC, Figure.ROBOT]
    assert [shape.numbers for shape in shapes] == [(1, 2, 3, 4), (-10, 20, 30, 40, 0, 3600), (5, 6, 70, 80)]
    # Mode 2 is XOR: the same line again erases it.
    second.ask("draw_line", 1, 2, 3, 4, 2)
    assert [shape.figure for shape in emulator.graphics.shapes] == [Figure.ARC, Figure.ROBOT]
