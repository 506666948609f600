"""The shape of laser blocks, as the recorded client follows it."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import (
    EVERYTHING,
    N150,
    N200,
    NO_MASK_MODELS,
    SCOUT,
    line_laser_width,
    serial_wire_state,
    tcp_laser_width,
    tcp_wire_state,
)


# Numbers a reading in each mode. On the serial line the bits 1 to 4 of the mode decide: lines if all are clear.
@pytest.mark.parametrize(("mode", "over_tcp", "on_the_line"), [
    (1, 4, 4), (33, 4, 4), (51, 2, 1), (50, 2, 1), (19, 2, 1), (35, 1, 1), (49, 1, 1), (0, 1, 4), (32, 1, 4),
])
def test_numbers_a_reading(mode: int, over_tcp: int, on_the_line: int) -> None:
    assert tcp_laser_width(mode) == over_tcp
    assert line_laser_width(mode) == on_the_line


def test_what_each_question_does_to_the_shape_over_tcp() -> None:
    wire_state = tcp_wire_state(N200)
    seen = [(wire_state.laser_width, wire_state.get_laser_width)]
    for call in (
        Call("get_sg"),
        Call("get_ls"),
        Call("conf_ls", (33, 0, 0, 0, 0)),
        Call("get_ls"),
        Call("get_sg"),
        Call("conf_ls", (35, 0, 0, 0, 0)),
        Call("gs"),
    ):
        codec.update_from_request(call, wire_state)
        seen.append((wire_state.laser_width, wire_state.get_laser_width))
    # get_sg: later state replies in line shape. get_ls in mode 33, a line mode: in point shape, as the reply to
    # get_ls. conf_ls sets both anew: mode 33 lines, mode 35 one number.
    assert seen == [(2, 2), (4, 2), (4, 2), (4, 2), (2, 2), (4, 2), (1, 1), (1, 1)]


def test_serial_laser_layout_depends_on_the_mode_alone() -> None:
    wire_state = serial_wire_state(N200)
    seen = [(wire_state.laser_width, wire_state.get_laser_width)]
    for call in (Call("get_sg"), Call("conf_ls", (33, 0, 0, 0, 0)), Call("get_ls"), Call("conf_ls", (51, 0, 0, 0, 0))):
        codec.update_from_request(call, wire_state)
        seen.append((wire_state.laser_width, wire_state.get_laser_width))
    # A serial robot sends the shape of its mode, whatever was requested last; get_ls always has pixels.
    assert seen == [(1, 1), (1, 1), (4, 1), (4, 1), (1, 1)]
    assert wire_state.copy().line


def test_terms_at_the_start_and_copies_of_them() -> None:
    assert serial_wire_state(N200).mask == EVERYTHING
    assert serial_wire_state(N150).mask == serial_wire_state(SCOUT).mask == NO_MASK_MODELS
    wire_state = tcp_wire_state(N150)
    copy = wire_state.copy()
    codec.update_from_request(Call("ct", NO_MASK_MODELS.smask), wire_state)
    # Copies are independent: a request changes the original only.
    assert copy.mask == EVERYTHING
    assert wire_state.mask == NO_MASK_MODELS
