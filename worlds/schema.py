"""Validation of TOML tables: read one value after another and report exactly what is wrong.

All errors are WorldFileError: file, key path (`wall[2].points_in[0]`, counted from 0), what was expected, what was
found. Lengths are given in inches, centimetres or metres; the key names the unit: x_in, x_cm or x_m, exactly one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite, radians
from pathlib import Path
from typing import Any, Final, NoReturn

from nclient.common import files
from nclient.common.hints import suggest
from nclient.errors import WorldFileError
from worlds.geometry import area, crossing, lengths, polygon_segments

INCHES_PER_UNIT: Final = {"in": 1.0, "cm": 1.0 / 2.54, "m": 100.0 / 2.54}
"""Inches in one of each unit that a key may end in."""

MAX_COORDINATE_IN: Final = 1e5
"""Largest coordinate, inches (2.5 km): beyond it rounding approaches the tolerances of the ray caster, and the unit is
nearly always wrong."""

MIN_WALL_IN: Final = 1e-6
"""A shorter wall is a repeated corner, inches: far above the ray caster's 1e-9, far below any real wall."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a file: `file` and `path` ("" for the top) for error messages, and its values."""

    file: str
    path: str
    values: Mapping[str, Any]

    def fail(self, key: str, complaint: str) -> NoReturn:
        """Raise WorldFileError about a key of this table; "" means the table itself."""
        place = ".".join(part for part in (self.path, key) if part)
        raise WorldFileError(f"{self.file}: {place}: {complaint}" if place else f"{self.file}: {complaint}")

    def allow(self, keys: Iterable[str], lengths: Iterable[str] = ()) -> None:
        """Reject all keys but these; a name in `lengths` stands for its three keys, one per unit."""
        allowed = [*keys, *(key for name in lengths for key in _length_keys(name))]
        for key in self.values:
            if key not in allowed:
                self.fail(key, f"unknown key; expected one of {', '.join(allowed)}{suggest(key, allowed)}")

    def text(self, key: str, default: str) -> str:
        """Return the text under a key, which must not be empty, or the default."""
        value = self.values.get(key, default)
        if not isinstance(value, str) or (key in self.values and not value.strip()):
            self.fail(key, f"expected a text, found {describe_value(value)}")
        return value

    def index(self, key: str, count: int, minimum: int = 0) -> int | None:
        """Return a whole number from `minimum` to `count` - 1; None if the key is not given."""
        if key not in self.values:
            return None
        value = self.values[key]
        # In Python True is an int, in TOML it is not.
        if not isinstance(value, int) or isinstance(value, bool) or not minimum <= value < count:
            self.fail(key, f"expected a whole number from {minimum} to {count - 1}, found {describe_value(value)}")
        return value

    def flag(self, key: str) -> bool:
        """Return a boolean; the key must be present."""
        value = self.values[key]
        if not isinstance(value, bool):
            self.fail(key, f"expected true or false, found {describe_value(value)}")
        return value

    def number(self, key: str, low: float, high: float) -> float:
        """Return a number from `low` to `high`; the key must be present."""
        return self._between(key, self.values[key], low, high)

    def numbers(self, key: str, count: int, low: float, high: float) -> tuple[float, ...]:
        """Return exactly `count` numbers from `low` to `high`; the key must be present."""
        rows = self.values[key]
        if not isinstance(rows, list) or len(rows) != count:
            self.fail(key, f"expected a list of {count} numbers, found {describe_value(rows)}")
        return tuple(self._between(f"{key}[{number}]", row, low, high) for number, row in enumerate(rows))

    def indices(self, key: str, count: int) -> tuple[int, ...]:
        """Return a sorted list of different whole numbers from 0 to `count` - 1; the key must be present."""
        rows = self.values[key]
        if not isinstance(rows, list):
            self.fail(key, f"expected a list of whole numbers from 0 to {count - 1}, found {describe_value(rows)}")
        for number, row in enumerate(rows):
            if not isinstance(row, int) or isinstance(row, bool) or not 0 <= row < count:
                self.fail(
                    f"{key}[{number}]", f"expected a whole number from 0 to {count - 1}, found {describe_value(row)}"
                )
        if len(set(rows)) < len(rows):
            self.fail(key, f"expected each number once, found {describe_value(rows)}")
        return tuple(sorted(rows))

    def angle_rad(self, name: str) -> float:
        """Return the angle under the key `name`_deg in radians; 0 if it is not given."""
        key = f"{name}_deg"
        return radians(self._number(key, self.values.get(key, 0.0), "an angle in degrees"))

    def length_in(self, name: str) -> float:
        """Return the length under exactly one of the keys `name`_in, _cm, _m, in inches."""
        key, scale = self._unit(name)
        return self._length(key, self.values[key], scale)

    def points_in(self, name: str, minimum: int) -> tuple[Point, ...]:
        """Return points [x, y] under exactly one of the keys `name`_in, _cm, _m, in inches."""
        key, scale = self._unit(name)
        rows = self.values[key]
        if not isinstance(rows, list):
            self.fail(key, f"expected a list of points [[x, y], ...], found {describe_value(rows)}")
        if len(rows) < minimum:
            self.fail(key, f"expected at least {minimum} points, found {len(rows)}")
        return tuple(self._point(f"{key}[{number}]", row, scale) for number, row in enumerate(rows))

    def table(self, key: str) -> Table:
        """Return the table [key] inside this one; it must be present."""
        row = self.values[key]
        if not isinstance(row, dict):
            self.fail(key, f"expected a table, found {describe_value(row)}")
        return Table(self.file, f"{self.path}.{key}" if self.path else key, row)

    def tables(self, key: str) -> Iterator[Table]:
        """Yield the tables [[key]] in order; none if there is no such key."""
        rows = self.values.get(key, [])
        expected = f"expected tables under [[{key}]], each with its double brackets"
        if not isinstance(rows, list):
            self.fail(key, f"{expected}, found {describe_value(rows)}")
        for number, row in enumerate(rows):
            if not isinstance(row, dict):
                self.fail(f"{key}[{number}]", f"{expected}, found {describe_value(row)}")
            yield Table(self.file, f"{self.path}{key}[{number}]", row)

    def key_of(self, name: str) -> str:
        """Return the key, with unit, under which the length `name` is given."""
        return self._unit(name)[0]

    def _unit(self, name: str) -> tuple[str, float]:
        # Exactly one of the keys with a unit must be present.
        keys = _length_keys(name)
        given = [key for key in keys if key in self.values]
        if len(given) != 1:
            count = " and ".join(given) if given else "none of them"
            self.fail(given[-1] if given else keys[0], f"expected exactly one of {', '.join(keys)}, found {count}")
        return given[0], INCHES_PER_UNIT[given[0].rpartition("_")[2]]

    def _point(self, place: str, row: object, scale: float) -> Point:
        if not isinstance(row, list) or len(row) != 2:
            self.fail(place, f"expected a point [x, y], found {describe_value(row)}")
        return self._length(f"{place}[0]", row[0], scale), self._length(f"{place}[1]", row[1], scale)

    def _length(self, place: str, value: object, scale: float) -> float:
        length = self._number(place, value, "a length") * scale
        if abs(length) > MAX_COORDINATE_IN:
            # The limit in the unit of the file.
            limit = MAX_COORDINATE_IN / scale
            self.fail(
                place,
                f"expected at most {limit:g} in either direction, found {describe_value(value)}; is the unit right?",
            )
        return length

    def _between(self, place: str, value: object, low: float, high: float) -> float:
        number = self._number(place, value, f"{low:g} to {high:g}")
        if not low <= number <= high:
            self.fail(place, f"expected {low:g} to {high:g}, found {describe_value(value)}")
        return number

    def _number(self, place: str, value: object, what: str) -> float:
        if not isinstance(value, int | float) or isinstance(value, bool):
            self.fail(place, f"expected {what}, a number, found {describe_value(value)}")
        # An int may exceed the range of a float, and TOML has inf and nan.
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        if not isfinite(number):
            self.fail(place, f"expected {what}, a finite number, found {describe_value(value)}")
        return number


def describe_value(value: object) -> str:
    """Return a value as text for an error message: kind and value, shortened if long."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {_short(repr(value))}"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"the list {_short(repr(value))}"
    if isinstance(value, int) and abs(value) >= 10**30:
        return "a number of more than 30 digits"
    return _short(str(value))


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _length_keys(name: str) -> list[str]:
    return [f"{name}_{unit}" for unit in INCHES_PER_UNIT]


MAX_BYTES: Final = 1 << 22
"""Largest file: about forty thousand obstacles, which Python's TOML reader needs seconds for."""


def read_text(path: Path) -> str:
    """Return the UTF-8 text of a world, setup or model file. Raises WorldFileError."""
    return files.read_text(path, MAX_BYTES, WorldFileError)


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `file` is its name in errors. Raises WorldFileError."""
    return files.parse_toml(text, file, WorldFileError)


def require_outline(table: Table, key: str, corners: tuple[Point, ...]) -> None:
    """Reject an outline whose edges cross or enclose no area, with a WorldFileError about the key."""
    edges = polygon_segments(corners)
    try:
        crossed = crossing(edges)
    except ValueError as error:
        table.fail(key, f"cannot be checked for edges that cross: {error}; expected a simpler outline")
    if crossed is not None:
        one, other = crossed
        table.fail(key, f"expected the corners in their order around, found edges {one} and {other} that cross")
    if abs(area(corners)) <= MIN_WALL_IN * float(lengths(edges).max()):
        table.fail(key, "expected an outline around some area, found corners on one line")
