"""The model guessed from a state packet, and the hint made of it."""

from __future__ import annotations

import pytest

from nclient.protocol.decode import guess_model, model_mismatch_hint
from nclient.protocol.replies import LINE_STATE, Reply
from nclient.protocol.types import MODELS, N150, N200, SCOUT, Model, serial_wire_state


def packet(
    model: Model, laser_mode: int = 51, laser: tuple[int, ...] = (0,), slots: dict[int, int] | None = None
) -> bytes:
    wire_state = serial_wire_state(model)
    wire_state.set_laser_mode(laser_mode)
    return LINE_STATE.build(Reply("state", slots or {33: model.bumper_rest}, laser), wire_state)


@pytest.mark.parametrize("model", MODELS.values())
def test_a_packet_looks_like_its_sender(model: Model) -> None:
    assert guess_model(packet(model)) is model


def test_a_n200_in_any_laser_mode() -> None:
    # The packet's length depends on the number of readings and on their size: pixels in mode 51, lines in mode 33.
    assert guess_model(packet(N200, 51, (3, 1, 2, 3))) is N200
    assert guess_model(packet(N200, 33, (2, *range(8)))) is N200


def test_a_touched_scout_is_no_n150() -> None:
    # N150 and Scout send packets of the same length. On a N150 the top four bumper bits always read 1.
    assert guess_model(packet(SCOUT, slots={33: 0x3F})) is SCOUT


# 41 and 43: one byte less and one more than the 42 of a N150 or a Scout.
@pytest.mark.parametrize("data", [b"", b"\0" * 41, b"\0" * 43])
def test_packet_of_no_model(data: bytes) -> None:
    assert guess_model(data) is None


def test_the_remedy() -> None:
    assert model_mismatch_hint(N150, packet(N200)) == "it looks like a n200's: write model=n200 in the address"
    assert model_mismatch_hint(N150, packet(N150)) == ""
    assert model_mismatch_hint(N150) == "is it a n150? Else write model=n200 or model=scout in the address"
    assert model_mismatch_hint(N200, b"") == "is it a n200? Else write model=n150 or model=scout in the address"
