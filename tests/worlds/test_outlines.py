"""Outlines that are none, and what is stated of them."""

from __future__ import annotations

import pytest

from nclient.errors import WorldFileError
from worlds.schema import Point, Table, require_outline

TABLE = Table("f", "", {})
SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], (*SQUARE, SQUARE[0])])
def test_either_path_round_and_closed_by_its_first_corner_it_is_one(corners: tuple[Point, ...]) -> None:
    require_outline(TABLE, "fence_in", corners)


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        ((SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]), "in their order around, found edges 0 and 2 that cross"),
        (((0.0, 0.0), (1.0, 1.0), (3.0, 3.0)), "around some area, found corners on one line"),
        ((SQUARE[1],) * 3, "around some area, found corners on one line"),
    ],
)
def test_what_crosses_itself_or_has_no_area_is_refused(corners: tuple[Point, ...], said: str) -> None:
    with pytest.raises(WorldFileError, match=rf"^f: fence_in: expected .*{said}$"):
        require_outline(TABLE, "fence_in", corners)
