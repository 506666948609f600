"""Typed access to TOML tables, and its error messages."""

from __future__ import annotations

import datetime

import pytest

from nclient.errors import WorldFileError
from worlds.schema import Table, describe_value


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
    assert describe_value(value) == words


def test_found_is_never_long() -> None:
    assert len(describe_value("x" * 1000)) < 80
    assert describe_value(list(range(1000))).endswith("...")


TABLE = Table("f", "t", {"n": 2, "on": True, "ns": [1, 2.5], "of": [3, 0], "no": "x"})


def test_valid_values_are_returned_unchanged() -> None:
    assert TABLE.number("n", 2.0, 2.0) == 2.0
    assert TABLE.flag("on") is True
    assert TABLE.numbers("ns", 2, 1.0, 2.5) == (1.0, 2.5)
    assert TABLE.indices("of", 4) == (0, 3)


def test_values_of_wrong_range_or_type_are_refused() -> None:
    with pytest.raises(WorldFileError, match=r"f: t\.n: .*3 to 4, found 2"):
        TABLE.number("n", 3.0, 4.0)
    with pytest.raises(WorldFileError, match=r"t\.n: .*true or false, found 2"):
        TABLE.flag("n")
    with pytest.raises(WorldFileError, match=r"t\.ns\[1\]: .*0 to 2, found 2\.5"):
        TABLE.numbers("ns", 2, 0.0, 2.0)
    with pytest.raises(WorldFileError, match=r"t\.ns: .*3 numbers"):
        TABLE.numbers("ns", 3, 0.0, 9.0)
    with pytest.raises(WorldFileError, match=r"t\.of\[0\]: .*whole .*0 to 2, found 3"):
        TABLE.indices("of", 3)
    assert (TABLE.index("n", 3, 1), TABLE.index("n", 3, 2)) == (2, 2)
    with pytest.raises(WorldFileError, match=r"t\.n: .*whole .*3 to 8, found 2"):
        TABLE.index("n", 9, 3)
    with pytest.raises(WorldFileError, match=r"t\.no: .*whole numbers"):
        TABLE.indices("no", 3)
