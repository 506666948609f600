"""Invalid outlines and their error messages."""

from __future__ import annotations

import pytest

from nclient.common.validation import InvalidValue
from worlds.schema import Point, require_outline

SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], (*SQUARE, SQUARE[0])])
def test_both_orientations_and_closed_outline_are_valid(corners: tuple[Point, ...]) -> None:
    require_outline("fence_in", corners)


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        # The corners of a square in the order of an hourglass.
        ((SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]), "in their order around, found edges 0 and 2 that cross"),
        (((0.0, 0.0), (1.0, 1.0), (3.0, 3.0)), "around some area, found corners on one line"),
        ((SQUARE[1],) * 3, "around some area, found corners on one line"),
    ],
)
def test_crossing_or_flat_outline_is_refused(corners: tuple[Point, ...], expected: str) -> None:
    with pytest.raises(InvalidValue, match=rf"^fence_in: expected .*{expected}$"):
        require_outline("fence_in", corners)
