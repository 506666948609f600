"""Settings made by a program: refused and accepted values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from localization.navigation.pilot import OnLost, Settings
from nclient.errors import MissionFileError


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"title": 3}, "title: expected a text, found 3"),
        ({"map": 5}, "map: expected a text, found 5"),
        ({"time_limit_s": "300"}, "time_limit_s: expected 0.1 to 86400, a number, found the text '300'"),
        ({"time_limit_s": float("nan")}, "time_limit_s: expected 0.1 to 86400, a finite number, found nan"),
        ({"lost_s": -1}, "lost_s: expected 0.1 to 86400, found -1"),
        ({"on_lost": "serach"}, "on_lost: expected one of stop, search, give_up, found 'serach'; did you mean search?"),
        ({"on_lost": None}, "on_lost: expected one of stop, search, give_up, found None"),
        ({"on_lost": ["stop"]}, "on_lost: expected one of stop, search, give_up, found the list ['stop']"),
        ({"fence_in": [[0, 0], [30]]}, "fence_in: expected at least 3 points, found 2"),
        ({"fence_in": [[0, 0], [30], [3, 4]]}, "fence_in[1]: expected a point [x, y], found the list [30]"),
        ({"fence_in": None}, "fence_in: expected a list of points [[x, y], ...], found None"),
        ({"fence_in": [(0, 0), (1, 1), (2, 2)]},
         "fence_in: expected an outline around some area, found corners on one line"),
        ({"fence_in": [(0, 0), (9, 9), (9, 0), (0, 9)]},
         "fence_in: expected the corners in their order around, found edges 0 and 2 that cross"),
    ],
)  # fmt: skip
def test_invalid_values_are_refused_at_construction(values: dict[str, Any], expected: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        Settings(**values)
    assert str(refused.value) == f"Settings: {expected}"


def test_equivalent_settings_are_equal() -> None:
    loose: dict[str, Any] = {"on_lost": "search", "fence_in": [[0, 0], [9, 0], [0, 9]], "map": Path("worlds/x.toml")}
    fence = ((0.0, 0.0), (9.0, 0.0), (0.0, 9.0))
    strict = Settings(map="worlds/x.toml", fence_in=fence, on_lost=OnLost.SEARCH)
    assert Settings(**loose) == strict
    assert hash(Settings(**loose)) == hash(strict)
