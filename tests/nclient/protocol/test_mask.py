"""Smask in its two byte layouts, against bit positions counted here by hand from the documentation."""

from __future__ import annotations

import pytest
from hypothesis import given, settings

from nclient.errors import WireError
from nclient.protocol.types import EVERYTHING, NO_MASK_MODELS, Mask, Position, mask_from_line, mask_from_tcp
from tests.nclient.protocol.strategies import line_masks, masks


def only(slot: int, position: int = 0) -> Mask:
    return Mask((position, *[int(k == slot) for k in range(1, 44)]))


@pytest.mark.parametrize("slot", range(1, 41))
def test_slots_1_to_40_have_a_bit_each_from_the_lowest_on(slot: int) -> None:
    byte, bit = divmod(slot - 1, 8)
    expected = tuple(1 << bit if k == byte else 0 for k in range(7))
    # Both layouts share b0 to b4: slot 1 is bit 0 of b0, slot 40 is bit 7 of b4.
    assert only(slot).tcp_bytes() == expected
    assert only(slot).line_bytes() == expected


def test_the_last_two_bytes_differ() -> None:
    # TCP: b5 holds Smask[41], [42], [43] in its bits 1, 2, 3. Serial: laser in b5, compass in b6.
    assert [only(slot).tcp_bytes()[5:] for slot in (41, 42, 43)] == [(2, 0), (4, 0), (8, 0)]
    assert [only(slot).line_bytes()[5:] for slot in (41, 42, 43)] == [(0, 0), (1, 0), (0, 1)]
    # 9 = 8 (Smask[43]) + 1 (any position data); 37 = 1 (compass) + 2 x 18.
    assert only(43, position=18).tcp_bytes()[5:] == (9, 18)
    assert only(43, position=18).line_bytes()[5:] == (0, 37)


def test_the_masks_every_connection_starts_with() -> None:
    # 14 = 2 + 4 + 8: Smask[41] to Smask[43] on, no position data.
    assert EVERYTHING.tcp_bytes() == (255, 255, 255, 255, 255, 14, 0)
    assert EVERYTHING.line_bytes() == (255, 255, 255, 255, 255, 1, 1)
    # N150 and Scout: no infrared (1 to 16), no laser (42), no Smask[41].
    assert [slot for slot in range(1, 44) if NO_MASK_MODELS.has(slot)] == [*range(17, 41), 43]


@settings(max_examples=50)
@given(masks, line_masks)
def test_masks_come_back_from_their_bytes(mask: Mask, on_the_line: Mask) -> None:
    assert mask_from_tcp(mask.tcp_bytes()) == mask
    assert mask_from_line(on_the_line.line_bytes()) == on_the_line


def test_only_the_low_bits_of_a_word_count() -> None:
    # The same bytes in words whose upper 24 bits are all set.
    data = [word | -256 for word in only(3, position=5).tcp_bytes()]
    assert mask_from_tcp([*data[:5], 1, data[6]]) == only(3, position=5)


def test_position_bits_are_set_apart() -> None:
    mask = EVERYTHING.with_position(Position.SONAR | Position.LASER)
    assert mask.position == 10
    assert mask.smask[1:] == EVERYTHING.smask[1:]


@pytest.mark.parametrize("numbers", [
    # No numbers, 43 and 45 instead of 44, position bits out of 0..31, and a mask entry of 2.
    (), (0,) * 43, (0,) * 45, (32, *[0] * 43), (-1, *[0] * 43), (0, 2, *[0] * 42),
])
def test_numbers_that_are_no_mask(numbers: tuple[int, ...]) -> None:
    with pytest.raises(WireError, match="a mask"):
        Mask(numbers)
