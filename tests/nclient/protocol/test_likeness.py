"""A state packet tells whose it is, and a message made of that names the remedy."""

from __future__ import annotations

import pytest

from nclient.protocol.decode import is_it_another, model_like
from nclient.protocol.replies import LINE_STATE, Reply
from nclient.protocol.types import MODELS, N150, N200, SCOUT, Model
from nclient.protocol.wire_state import line_terms


def packet(
    model: Model, laser_mode: int = 51, laser: tuple[int, ...] = (0,), slots: dict[int, int] | None = None
) -> bytes:
    terms = line_terms(model)
    terms.note_laser_mode(laser_mode)
    return LINE_STATE.build(Reply("state", slots or {33: model.bumper_rest}, laser), terms)


@pytest.mark.parametrize("model", MODELS.values())
def test_a_packet_looks_like_its_sender(model: Model) -> None:
    assert model_like(packet(model)) is model


def test_a_n200_in_any_laser_mode() -> None:
    assert model_like(packet(N200, 51, (3, 1, 2, 3))) is N200
    assert model_like(packet(N200, 33, (2, *range(8)))) is N200


def test_a_touched_scout_is_no_n150() -> None:
    assert model_like(packet(SCOUT, slots={33: 0x3F})) is SCOUT


@pytest.mark.parametrize("data", [b"", b"\0" * 41, b"\0" * 43])
def test_nobodys(data: bytes) -> None:
    assert model_like(data) is None


def test_the_remedy() -> None:
    assert is_it_another(N150, packet(N200)) == "it looks like a n200's: say model=n200 in the address"
    assert is_it_another(N150, packet(N150)) == ""
    assert is_it_another(N150) == "is it a n150? Else say model=n200 or model=scout in the address"
    assert is_it_another(N200, b"") == "is it a n200? Else say model=n150 or model=scout in the address"
