"""The shape of laser blocks, as the recorded client follows it."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING, N150, N200, NO_MASK_MODELS, SCOUT
from nclient.protocol.wire_state import line_laser_width, line_terms, tcp_laser_width, tcp_terms


@pytest.mark.parametrize(("mode", "over_tcp", "on_the_line"), [
    (1, 4, 4), (33, 4, 4), (51, 2, 1), (50, 2, 1), (19, 2, 1), (35, 1, 1), (49, 1, 1), (0, 1, 4), (32, 1, 4),
])
def test_numbers_a_reading(mode: int, over_tcp: int, on_the_line: int) -> None:
    assert tcp_laser_width(mode) == over_tcp
    assert line_laser_width(mode) == on_the_line


def test_what_each_question_does_to_the_shape_over_tcp() -> None:
    terms = tcp_terms(N200)
    seen = [(terms.laser_width, terms.get_laser_width)]
    for call in (
        Call("get_sg"),
        Call("get_ls"),
        Call("conf_ls", (33, 0, 0, 0, 0)),
        Call("get_ls"),
        Call("get_sg"),
        Call("conf_ls", (35, 0, 0, 0, 0)),
        Call("gs"),
    ):
        codec.note(call, terms)
        seen.append((terms.laser_width, terms.get_laser_width))
    assert seen == [(2, 2), (4, 2), (4, 2), (4, 2), (2, 2), (4, 2), (1, 1), (1, 1)]


def test_on_the_robots_own_line_the_mode_alone_says_the_shape_and_get_ls_gives_pixels() -> None:
    terms = line_terms(N200)
    seen = [(terms.laser_width, terms.get_laser_width)]
    for call in (Call("get_sg"), Call("conf_ls", (33, 0, 0, 0, 0)), Call("get_ls"), Call("conf_ls", (51, 0, 0, 0, 0))):
        codec.note(call, terms)
        seen.append((terms.laser_width, terms.get_laser_width))
    assert seen == [(1, 1), (1, 1), (4, 1), (4, 1), (1, 1)]
    assert terms.copy().line


def test_terms_at_the_start_and_copies_of_them() -> None:
    assert line_terms(N200).mask == EVERYTHING
    assert line_terms(N150).mask == line_terms(SCOUT).mask == NO_MASK_MODELS
    terms = tcp_terms(N150)
    copy = terms.copy()
    codec.note(Call("ct", NO_MASK_MODELS.smask), terms)
    assert copy.mask == EVERYTHING
    assert terms.mask == NO_MASK_MODELS
