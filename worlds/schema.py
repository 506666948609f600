"""Types of world, model and mission files: lengths in inches, centimetres or metres, points, angles; and their tables.

A key names its unit: x_in, x_cm or x_m, exactly one of them.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Final, TypeVar, get_args, get_type_hints

import msgspec
from msgspec import UNSET, Meta, UnsetType

from nclient.common import files
from nclient.common.validation import InvalidValue, at_most_one
from nclient.errors import WorldFileError
from worlds.geometry import area, crossing, lengths, polygon_segments

INCHES_PER_UNIT: Final = {"in": 1.0, "cm": 1.0 / 2.54, "m": 100.0 / 2.54}
"""Inches in one of each unit that a key may end in."""

_UNITS: Final = {"in": "inches", "cm": "centimetres", "m": "metres"}

MAX_COORDINATE_IN: Final = 1e5
"""Largest coordinate, inches (2.5 km): beyond it rounding approaches the tolerances of the ray caster, and the unit is
nearly always wrong."""

MIN_WALL_IN: Final = 1e-6
"""A shorter wall is a repeated corner, inches: far above the ray caster's 1e-9, far below any real wall."""

MAX_BYTES: Final = 1 << 22
"""Largest file: about forty thousand obstacles, which Python's TOML reader needs seconds for."""

Point = tuple[float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class InUnits:
    """Marks a type whose keys end in a unit; `type_for` makes the type for the largest number in that unit."""

    type_for: Callable[[float], Any]


def _length(limit: float) -> Any:
    hint = {"x-hint": "; is the unit right?"}
    return Annotated[float, Meta(ge=-limit, le=limit, title="a length", extra_json_schema=hint)]


def _point(limit: float) -> Any:
    numbers: Any = GenericAlias(tuple, (_length(limit), ...))
    return Annotated[numbers, Meta(min_length=2, max_length=2, title="a point [x, y]")]


def points(least: int) -> InUnits:
    """Return the mark of a list of at least so many points."""

    def type_for(limit: float) -> Any:
        rows: Any = GenericAlias(tuple, (_point(limit), ...))
        title = "a list of points [[x, y], ...]"
        return Annotated[rows, Meta(min_length=least, title=title, extra_json_schema={"x-items": "points"})]

    return InUnits(type_for)


def _spots(limit: float) -> Any:
    numbers: Any = GenericAlias(tuple, (_length(limit), ...))
    spot = Annotated[numbers, Meta(min_length=3, max_length=3, title="a spot [x, y, standard deviation]")]
    rows: Any = GenericAlias(tuple, (spot, ...))
    title = "a list of spots [[x, y, standard deviation], ...]"
    return Annotated[rows, Meta(min_length=1, title=title, extra_json_schema={"x-items": "spots"})]


Length = Annotated[float, InUnits(_length)]
Distance = Annotated[float, InUnits(lambda limit: Annotated[float, Meta(gt=0.0, le=limit, title="a length")])]
"""A length, or a speed in lengths, above 0."""
PointInUnits = Annotated[Point, InUnits(_point)]
Points = Annotated[tuple[Point, ...], points(1)]
Line = Annotated[tuple[Point, ...], points(2)]
Outline = Annotated[tuple[Point, ...], points(3)]
Spots = Annotated[tuple[tuple[float, float, float], ...], InUnits(_spots)]
"""Spots of a surface: x, y, and the standard deviation of its distance from the wall."""
LengthIn = _length(MAX_COORDINATE_IN)
"""A length in inches; PointsIn: points in inches."""
PointsIn = points(1).type_for(MAX_COORDINATE_IN)
Angle = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max, title="an angle in degrees")]
PositiveAngle = Annotated[float, Meta(gt=0.0, le=sys.float_info.max, title="an angle in degrees")]


class Table:
    """Base of the classes that `table` makes tables of."""

    def check(self) -> None:
        """Raise InvalidValue if the values do not fit together."""

    def key_of(self, name: str) -> str:
        """Return the key, with unit, that gives a field in units."""
        return next(key for key in _keys(name) if getattr(self, key) is not UNSET)


def _keys(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{unit}" for unit in INCHES_PER_UNIT)


def table(*one_of: tuple[str, ...], condition: dict[str, Any] | None = None,
          **tag: str) -> Callable[[type[T]], type[T]]:
    """Return a decorator that makes a msgspec struct of a class with annotations: a table of a file.

    Unknown keys are refused. A field in units is read from exactly one of NAME_in, NAME_cm, NAME_m, and is in inches;
    one with the default UNSET may be missing.

    Parameters
    ----------
    one_of
        Further keys of which exactly one must be given.
    condition
        What the class's `check` checks, as JSON Schema.
    tag
        Key and value that distinguish the table from others: do="turn".
    """

    def build(cls: type[T]) -> type[T]:
        # 1. Fields: as annotated, or one for each unit.
        fields: list[Any] = []
        groups = [(keys, 1) for keys in one_of]
        members = {name: each for base in cls.__mro__[-2::-1] for name, each in vars(base).items() if callable(each)}
        for name, kind in get_type_hints(cls, include_extras=True).items():
            mark = _mark(kind)
            if mark is not None:
                fields += [_unit_field(name, unit, kind, mark) for unit in INCHES_PER_UNIT]
                groups.append((_keys(name), 0 if hasattr(cls, name) else 1))
                members[name] = property(_reader(name))
            else:
                fields.append((name, kind, getattr(cls, name)) if hasattr(cls, name) else (name, kind))
        # 2. Checks of several keys.
        members["__doc__"] = cls.__doc__
        members["__post_init__"] = lambda self: _check_groups(self, groups)
        members["CONDITIONS"] = [*(at_most_one(*group) for group in groups), *([condition] if condition else [])]
        key, value = next(iter(tag.items()), (None, None))
        made: Any = msgspec.defstruct(cls.__name__.strip("_"), fields, namespace=members, module=cls.__module__,
                                      frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field=key, tag=value)
        return made  # type: ignore[no-any-return]

    return build


def _mark(kind: Any) -> InUnits | None:
    """Return the mark of a type in units, which may be optional; None for other types."""
    marks = (mark for each in (kind, *get_args(kind)) for mark in getattr(each, "__metadata__", ()))
    return next((mark for mark in marks if isinstance(mark, InUnits)), None)


def _unit_field(name: str, unit: str, kind: Any, mark: InUnits) -> tuple[str, Any, Any]:
    metas = [each for each in getattr(kind, "__metadata__", ()) if isinstance(each, Meta)]
    meta = Meta(description=f"{metas[0].description if metas else name}, in {_UNITS[unit]}")
    limited = mark.type_for(MAX_COORDINATE_IN / INCHES_PER_UNIT[unit])
    return f"{name}_{unit}", Annotated[limited | UnsetType, meta], UNSET


def _reader(name: str) -> Callable[[Table], Any]:
    """Return a function that reads a field in units: inches, or UNSET."""

    def read(values: Table) -> Any:
        for key, scale in zip(_keys(name), INCHES_PER_UNIT.values(), strict=True):
            if getattr(values, key) is not UNSET:
                return _scaled(getattr(values, key), scale)
        return UNSET

    return read


def _scaled(value: Any, scale: float) -> Any:
    return value * scale if isinstance(value, float) else tuple(_scaled(each, scale) for each in value)


def _check_groups(values: Any, groups: list[tuple[tuple[str, ...], int]]) -> None:
    for keys, least in groups:
        given = [key for key in keys if getattr(values, key) is not UNSET]
        if not least <= len(given) <= 1:
            complaint = f"expected exactly one of {', '.join(keys)}, found {' and '.join(given) or 'none of them'}"
            raise InvalidValue(complaint, given[-1] if given else keys[0])
    values.check()


def read_text(path: Path) -> str:
    """Return the UTF-8 text of a world, setup or model file. Raises WorldFileError."""
    return files.read_text(path, MAX_BYTES, WorldFileError)


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `file` is its name in errors. Raises WorldFileError."""
    return files.parse_toml(text, file, WorldFileError)


def require_outline(key: str, corners: tuple[Point, ...]) -> None:
    """Raise InvalidValue about the key if the edges of an outline cross or enclose no area."""
    edges = polygon_segments(corners)
    try:
        crossed = crossing(edges)
    except ValueError as error:
        raise InvalidValue(f"expected a simpler outline: {error}", key) from None
    if crossed is not None:
        one, other = crossed
        raise InvalidValue(f"expected the corners in their order around, found edges {one} and {other} that cross", key)
    if abs(area(corners)) <= MIN_WALL_IN * float(lengths(edges).max()):
        raise InvalidValue("expected an outline around some area, found corners on one line", key)
