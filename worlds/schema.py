"""Reads one checked value after another out of a table of a TOML file, and says exactly what is wrong with it.

Knows of keys, kinds, units and lists of points; not of rooms or robots (files.py). Everything it raises is
WorldFileError: file, key path (`wall[2].points_in[0]`, counted from 0), what was expected, what was found.
Lengths come in inches, centimetres or metres, named by the key: x_in, x_cm or x_m, exactly one of them.

The text of a world, a setup, models, a calibration: how long it may be, and what is raised where there is none.

What a closed outline in a file has to be: around some area, its corners in their order.

Rules: checks corners that were read (tables.py), in the same words for rooms, obstacles and fences; reads nothing.
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

FARTHEST_IN: Final = 1e5
"""No coordinate lies farther out, inches (2.5 km): beyond it rounding nears the tolerances of the ray caster,
and what is written there is nearly always a wrong unit."""

SHORTEST_IN: Final = 1e-6
"""A shorter wall is a corner given twice, inches: far above the ray caster's 1e-9, far below any real wall."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the file: where it stands (`file`, `path`: "" for the top) and what it holds."""

    file: str
    path: str
    values: Mapping[str, Any]

    def fail(self, key: str, complaint: str) -> NoReturn:
        """Raise WorldFileError about one key of this table; "" is the table itself."""
        place = ".".join(part for part in (self.path, key) if part)
        raise WorldFileError(f"{self.file}: {place}: {complaint}" if place else f"{self.file}: {complaint}")

    def allow(self, keys: Iterable[str], lengths: Iterable[str] = ()) -> None:
        """Refuse every key but these; a name of a length stands for its three keys."""
        known = [*keys, *(key for name in lengths for key in _length_keys(name))]
        for key in self.values:
            if key not in known:
                self.fail(key, f"unknown key; expected one of {', '.join(known)}{suggest(key, known)}")

    def text(self, key: str, default: str) -> str:
        """A text that is not empty."""
        value = self.values.get(key, default)
        if not isinstance(value, str) or (key in self.values and not value.strip()):
            self.fail(key, f"expected a text, found {found(value)}")
        return value

    def index(self, key: str, count: int, least: int = 0) -> int | None:
        """A whole number from `least` below `count`, or None where the key is not given."""
        if key not in self.values:
            return None
        value = self.values[key]
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value < count:
            self.fail(key, f"expected a whole number from {least} to {count - 1}, found {found(value)}")
        return value

    def flag(self, key: str) -> bool:
        """true or false; the key is there."""
        value = self.values[key]
        if not isinstance(value, bool):
            self.fail(key, f"expected true or false, found {found(value)}")
        return value

    def number(self, key: str, low: float, high: float) -> float:
        """A number from `low` to `high`; the key is there."""
        return self._between(key, self.values[key], low, high)

    def numbers(self, key: str, count: int, low: float, high: float) -> tuple[float, ...]:
        """So many numbers from `low` to `high`; the key is there."""
        rows = self.values[key]
        if not isinstance(rows, list) or len(rows) != count:
            self.fail(key, f"expected a list of {count} numbers, found {found(rows)}")
        return tuple(self._between(f"{key}[{number}]", row, low, high) for number, row in enumerate(rows))

    def indices(self, key: str, count: int) -> tuple[int, ...]:
        """Any number of different whole numbers from 0 below `count`, sorted; the key is there."""
        rows = self.values[key]
        if not isinstance(rows, list):
            self.fail(key, f"expected a list of whole numbers from 0 to {count - 1}, found {found(rows)}")
        for number, row in enumerate(rows):
            if not isinstance(row, int) or isinstance(row, bool) or not 0 <= row < count:
                self.fail(f"{key}[{number}]", f"expected a whole number from 0 to {count - 1}, found {found(row)}")
        if len(set(rows)) < len(rows):
            self.fail(key, f"expected each number once, found {found(rows)}")
        return tuple(sorted(rows))

    def angle_rad(self, name: str) -> float:
        """The angle under the key `name`_deg, in radians; 0 where it is not given."""
        key = f"{name}_deg"
        return radians(self._number(key, self.values.get(key, 0.0), "an angle in degrees"))

    def length_in(self, name: str) -> float:
        """The length under exactly one of the keys `name`_in, _cm, _m; in inches."""
        key, scale = self._unit(name)
        return self._length(key, self.values[key], scale)

    def points_in(self, name: str, least: int) -> tuple[Point, ...]:
        """At least `least` points [x, y] under exactly one of the keys `name`_in, _cm, _m; in inches."""
        key, scale = self._unit(name)
        rows = self.values[key]
        if not isinstance(rows, list):
            self.fail(key, f"expected a list of points [[x, y], ...], found {found(rows)}")
        if len(rows) < least:
            self.fail(key, f"expected at least {least} points, found {len(rows)}")
        return tuple(self._point(f"{key}[{number}]", row, scale) for number, row in enumerate(rows))

    def table(self, key: str) -> Table:
        """The table written as [key] inside this one, which is there."""
        row = self.values[key]
        if not isinstance(row, dict):
            self.fail(key, f"expected a table, found {found(row)}")
        return Table(self.file, f"{self.path}.{key}" if self.path else key, row)

    def tables(self, key: str) -> Iterator[Table]:
        """The tables written as [[key]], in their order; none where there is no such key."""
        rows = self.values.get(key, [])
        wanted = f"expected tables under [[{key}]], each with its double brackets"
        if not isinstance(rows, list):
            self.fail(key, f"{wanted}, found {found(rows)}")
        for number, row in enumerate(rows):
            if not isinstance(row, dict):
                self.fail(f"{key}[{number}]", f"{wanted}, found {found(row)}")
            yield Table(self.file, f"{self.path}{key}[{number}]", row)

    def key_of(self, name: str) -> str:
        """The one key under which the length `name` is given, with its unit."""
        return self._unit(name)[0]

    def _unit(self, name: str) -> tuple[str, float]:
        keys = _length_keys(name)
        given = [key for key in keys if key in self.values]
        if len(given) != 1:
            count = " and ".join(given) if given else "none of them"
            self.fail(given[-1] if given else keys[0], f"expected exactly one of {', '.join(keys)}, found {count}")
        return given[0], INCHES_PER_UNIT[given[0].rpartition("_")[2]]

    def _point(self, place: str, row: object, scale: float) -> Point:
        if not isinstance(row, list) or len(row) != 2:
            self.fail(place, f"expected a point [x, y], found {found(row)}")
        return self._length(f"{place}[0]", row[0], scale), self._length(f"{place}[1]", row[1], scale)

    def _length(self, place: str, value: object, scale: float) -> float:
        length = self._number(place, value, "a length") * scale
        if abs(length) > FARTHEST_IN:
            limit = FARTHEST_IN / scale
            self.fail(place, f"expected at most {limit:g} either way, found {found(value)}; is the unit right?")
        return length

    def _between(self, place: str, value: object, low: float, high: float) -> float:
        number = self._number(place, value, f"{low:g} to {high:g}")
        if not low <= number <= high:
            self.fail(place, f"expected {low:g} to {high:g}, found {found(value)}")
        return number

    def _number(self, place: str, value: object, what: str) -> float:
        if not isinstance(value, int | float) or isinstance(value, bool):
            self.fail(place, f"expected {what}, a number, found {found(value)}")
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        if not isfinite(number):
            self.fail(place, f"expected {what}, a finite number, found {found(value)}")
        return number


def found(value: object) -> str:
    """What stands in the file, in words a person wrote: kind and value, cut where it gets long."""
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


MOST_BYTES: Final = 1 << 22
"""Some forty thousand obstacles, which Python's TOML takes seconds for; none that was made by hand comes near it."""


def read_text(path: Path) -> str:
    """What stands in a file, UTF-8. Raises WorldFileError."""
    return files.read_text(path, MOST_BYTES, WorldFileError)


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """What it holds; `file` is what errors call it. Raises WorldFileError."""
    return files.parse_toml(text, file, WorldFileError)


def require_outline(table: Table, key: str, corners: tuple[Point, ...]) -> None:
    """Refuse corners whose edges cross, or that lie on one line. Raises WorldFileError about the key."""
    edges = polygon_segments(corners)
    if crossed := crossing(edges):
        one, other = crossed
        table.fail(key, f"expected the corners in their order around, found edges {one} and {other} that cross")
    if abs(area(corners)) <= SHORTEST_IN * float(lengths(edges).max()):
        table.fail(key, "expected an outline around some area, found corners on one line")
