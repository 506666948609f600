"""What error messages say of a value that was found, and which known word they offer."""

from __future__ import annotations

import datetime

import pytest

from worlds.tables import found, nearest


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (True, "true"),
        (False, "false"),
        ("wall", "the text 'wall'"),
        (3, "3"),
        (-2.5, "-2.5"),
        ({"x": 1}, "a table"),
        ([1, 2], "the list [1, 2]"),
        (10**400, "a number of more than 30 digits"),
        (datetime.date(2006, 1, 2), "2006-01-02"),
    ],
)
def test_found_names_kind_and_value(value: object, words: str) -> None:
    assert found(value) == words


def test_found_is_never_long() -> None:
    assert len(found("x" * 1000)) < 80
    assert found(list(range(1000))).endswith("...")


def test_nearest_offers_one_word_or_none() -> None:
    assert nearest("pionts_in", ["points_in", "corners_in"]) == "; did you mean points_in?"
    assert nearest("zzz", ["points_in", "corners_in"]) == ""
