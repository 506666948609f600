"""Drawing commands over the wire, and what they leave to be read out."""

from __future__ import annotations

import pytest

from nserver_emu.server.graphics import Figure, Layer
from nserver_emu.server.handlers.graphics import REFRESHERS
from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import meet, simulation

ALL = set(Layer)
LAYERS = {
    "refresh_all": ALL,
    "refresh_all_traces": {Layer.ACTUAL_TRACE, Layer.ENCODER_TRACE},
    "refresh_actual_trace": {Layer.ACTUAL_TRACE},
    "refresh_encoder_trace": {Layer.ENCODER_TRACE},
    "refresh_all_sensors": {Layer.BUMPER, Layer.INFRARED, Layer.SONAR, Layer.LASER},
    "refresh_bumper_sensor": {Layer.BUMPER},
    "refresh_infrared_sensor": {Layer.INFRARED},
    "refresh_sonar_sensor": {Layer.SONAR},
    "refresh_laser_sensor": {Layer.LASER},
    "refresh_client_graphics": {Layer.CLIENT},
}


def test_all_ten_are_tested() -> None:
    assert set(LAYERS) == set(REFRESHERS)


@pytest.mark.parametrize("name", LAYERS)
def test_a_refresh_marks_its_layers_and_loses_nothing(name: str) -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    client.ask("draw_line", 0, 0, 10, 10, 1)
    assert client.ask(name).values == (0,)
    assert {layer for layer, count in emulator.graphics.redrawn.items() if count} == LAYERS[name]
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
    second.ask("draw_line", 1, 2, 3, 4, 2)
    assert [shape.figure for shape in emulator.graphics.shapes] == [Figure.ARC, Figure.ROBOT]
