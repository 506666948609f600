"""Conversion of plain data to types, and the error messages."""

from __future__ import annotations

import contextlib
import datetime
from dataclasses import dataclass
from math import inf, nan
from typing import Annotated, Any

import msgspec
import pytest
from hypothesis import given as given_by
from hypothesis import strategies as st
from msgspec import UNSET, Meta, UnsetType

from nclient.common.validation import (
    InvalidValue,
    Text,
    check_fields,
    convert,
    decode_json,
    describe_value,
    given,
    keys_of,
    one_of,
    reported_as,
)

Whole = Annotated[int, Meta(ge=2, le=8)]
Number = Annotated[float, Meta(ge=0.5, le=2.0)]


Pair = Annotated[tuple[Number, ...], Meta(min_length=2, max_length=2, title="a list of 2 numbers")]


class Inner(msgspec.Struct, forbid_unknown_fields=True):
    """A table in a list."""

    size: Number
    name: Text = ""

    # A check that the types cannot express.
    def __post_init__(self) -> None:
        if self.size == 1.5:
            raise InvalidValue("is out of stock", "size")


class Red(msgspec.Struct, tag_field="do", tag="red", forbid_unknown_fields=True):
    """One of two kinds of tables."""

    depth: Annotated[int, Meta(description="the depth, in mm")]


class Blue(msgspec.Struct, tag_field="do", tag="blue", forbid_unknown_fields=True):
    """The other."""


class Everything(msgspec.Struct, forbid_unknown_fields=True):
    """A file."""

    on: bool = False
    whole: Whole | UnsetType = UNSET
    more: Annotated[int, Meta(ge=1)] = 1
    plain: int = 0
    positive: Annotated[float, Meta(gt=0.0)] = 1.0
    few: Annotated[float, Meta(gt=0.0, le=9.0)] = 1.0
    late: Annotated[float, Meta(ge=3.0)] = 3.0
    length: Annotated[float, Meta(ge=-9.0, le=9.0, title="a length", extra_json_schema={"x-hint": "; is it?"})] = 0.0
    pair: Pair = (1.0, 1.0)
    rows: Annotated[tuple[Number, ...], Meta(min_length=2, max_length=3)] = (1.0, 1.0)
    words: str | list[str] = ""
    shape: one_of(("round", "square")) = "round"  # type: ignore[valid-type]
    inner: tuple[Inner, ...] = ()
    one: Inner | UnsetType = UNSET
    step: tuple[Red | Blue, ...] = ()


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
        # Python refuses to print numbers of more than 4300 digits.
        (10**400, "a number of more than 30 digits"),
        (datetime.date(2006, 1, 2), "2006-01-02"),
    ],
)
def test_found_names_kind_and_value(value: object, words: str) -> None:
    assert describe_value(value) == words


@pytest.mark.long
def test_found_is_never_long() -> None:
    assert len(describe_value("x" * 1000)) < 80
    assert describe_value(list(range(1000))).endswith("...")
    nested: list[Any] = []
    # Deeper than the recursion limit.
    for _ in range(100_000):
        nested = [nested]
    assert describe_value(nested) == "the list [[[[[...]]]]]"


def test_valid_values_are_returned() -> None:
    assert convert(2, Number) == 2.0
    assert convert([1, 2], Pair) == (1.0, 2.0)
    found = convert({"whole": 3, "inner": [{"size": 1}], "step": [{"do": "blue"}]}, Everything)
    assert given(found.inner[0]) == {"size": 1.0, "name": ""}
    assert found.step == (Blue(),)
    assert "one" in keys_of(found)
    assert not {"one"} & given(found).keys()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"on": 2}, "on: expected true or false, found 2"),
        ({"whole": 1}, "whole: expected a whole number from 2 to 8, found 1"),
        ({"whole": True}, "whole: expected a whole number from 2 to 8, found true"),
        ({"whole": 2.0}, "whole: expected a whole number from 2 to 8, found 2.0"),
        ({"more": 0}, "more: expected a whole number, 1 or more, found 0"),
        ({"plain": "x"}, "plain: expected a whole number, found the text 'x'"),
        ({"positive": -1}, "positive: expected more than 0, found -1"),
        ({"few": 10}, "few: expected more than 0, at most 9, found 10"),
        ({"late": 2}, "late: expected 3 or more, found 2"),
        ({"late": nan}, "late: expected 3 or more, a finite number, found nan"),
        ({"length": 10}, "length: expected -9 to 9, found 10; is it?"),
        ({"length": inf}, "length: expected a length, a finite number, found inf"),
        ({"length": 10**400}, "length: expected a length, a finite number, found a number of more than 30 digits"),
        ({"length": True}, "length: expected a length, a number, found true"),
        ({"pair": [1]}, "pair: expected a list of 2 numbers, found the list [1]"),
        ({"pair": [1, "x"]}, "pair[1]: expected 0.5 to 2, a number, found the text 'x'"),
        ({"rows": [1]}, "rows: expected at least 2 values, found 1"),
        ({"rows": [1, 1, 1, 1]}, "rows: expected at most 3 values, found 4"),
        ({"rows": [1, 0]}, "rows[1]: expected 0.5 to 2, found 0"),
        ({"words": [1]}, "words[0]: expected a text, found 1"),
        ({"words": 1}, "words: expected a text, found 1"),
        ({"shape": "sqare"}, "shape: expected one of round, square, found 'sqare'; did you mean square?"),
        ({"shape": 3}, "shape: expected one of round, square, found 3"),
        ({"inner": 3}, "inner: expected tables under [[inner]], each with its double brackets, found 3"),
        ({"inner": [3]}, "inner[0]: expected tables under [[inner]], each with its double brackets, found 3"),
        ({"inner": [{"size": 1}, {"size": 1.5}]}, "inner[1].size: is out of stock"),
        ({"inner": [{"size": 1, "name": " "}]}, "inner[0].name: expected a text, found the text ' '"),
        ({"inner": [{"siz": 1}]}, "inner[0].siz: unknown key; expected one of size, name; did you mean size?"),
        ({"inner": [{}]}, "inner[0].size: is missing"),
        ({"one": 3}, "one: expected a table, found 3"),
        ({"step": [{}]}, "step[0].do: is missing; expected one of red, blue"),
        ({"step": [{"do": "rad"}]}, "step[0].do: expected one of red, blue, found 'rad'; did you mean red?"),
        ({"step": [{"do": "red"}]}, "step[0].depth: is missing: the depth, in mm"),
        ({"step": [{"do": "red", "depth": 1, "colour": 2}]}, "step[0].colour: unknown key; expected one of do, depth"),
        (3, "expected a table, found 3"),
    ],
)
def test_errors_name_key_value_and_remedy(value: object, message: str) -> None:
    with pytest.raises(InvalidValue) as caught:
        convert(value, Everything)
    assert str(caught.value) == message


def test_a_named_value_stands_before_its_indices() -> None:
    with pytest.raises(InvalidValue, match=r"^points_in\[1\]: expected 0.5 to 2"):
        convert([1, 9], Pair, "points_in")


@pytest.mark.parametrize("value", [{"\ud800": 1}, {"shape": "\ud800"}, {"step": [{"do": "\ud800"}]}])
def test_half_of_a_surrogate_pair_is_refused(value: object) -> None:
    with pytest.raises(InvalidValue):
        convert(value, Everything)


@pytest.mark.parametrize("key", ["x` - at `$.inner", "a - at `$.b[0]`", "$", "", "inner[0]"])
def test_a_key_that_looks_like_a_path_is_only_text(key: str) -> None:
    with pytest.raises(InvalidValue):
        convert({key: 1}, Everything)


# Names of fields, so that random data reaches the nested tables.
KEYS = st.sampled_from([*Everything.__struct_fields__, "size", "name", "do"])
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=15,
)


@given_by(st.dictionaries(KEYS | st.text(max_size=9), JSON, max_size=3))
# Any other exception than InvalidValue is a failure.
def test_any_data_is_converted_or_explained(value: dict[str, Any]) -> None:
    with contextlib.suppress(InvalidValue):
        convert(value, Everything)


@dataclass
class Settings:
    """Settings made by a program."""

    size: Number = 1.0
    name: Text = "x"


def test_fields_of_a_dataclass_are_checked() -> None:
    check_fields(Settings(), ValueError)
    with pytest.raises(LookupError, match=r"size: .*0\.5 to 2, .*3"):
        check_fields(Settings(size=3), LookupError)


def test_errors_become_those_of_the_caller() -> None:
    with pytest.raises(LookupError, match=r"^f: wrong$"), reported_as(LookupError, "f"):
        raise InvalidValue("wrong")
    with pytest.raises(LookupError, match=r"^a: wrong$"), reported_as(LookupError):
        raise InvalidValue("wrong", "a")


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "nothing"])
def test_json_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InvalidValue, match="is no JSON"):
        decode_json(text)
