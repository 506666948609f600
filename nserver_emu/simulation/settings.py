"""Declare the settings of a robot setup next to the dataclass fields that hold them.

A field made with `setting` is a key of a setup file, a row of docs/setups.md and a checked value of a snapshot; the
range, the unit and the meaning stand here once. Angles are radians in the field and degrees in the file.
"""

from dataclasses import field, fields
from math import degrees, radians
from typing import Annotated, Any, Final, NamedTuple

from msgspec import Meta

from nclient.common.validation import InvalidValue, convert

_SETTING: Final = "setting"
SONAR_NUMBERS: Final = "sonars"
"""The unit of a list of sonar numbers."""


class Key(NamedTuple):
    """A key of a setup file.

    Attributes
    ----------
    table
        Table of the file, "" for the top.
    field
        Field of the dataclass behind that table.
    low, high
        Permitted range, in the unit of the file.
    unit, meaning
        For the documentation.
    former
        Key of earlier versions, still read; "" for none.
    sonar_model
        The only sonar model that has this key; "" for both.
    default
        Default of the dataclass, in the simulation's units.
    max_length
        Most numbers of a list whose length is that of the robot's ring; 0: as many as the default has.
    """

    table: str
    field: str
    low: float
    high: float
    unit: str
    meaning: str
    former: str = ""
    sonar_model: str = ""
    default: object = 0.0
    max_length: int = 0

    @property
    def name(self) -> str:
        """The key as users write it."""
        return f"{self.field.removesuffix('_rad')}_deg" if self.in_degrees else self.field

    @property
    def in_degrees(self) -> bool:
        """True for an angle, which the simulation holds in radians."""
        return self.field.endswith("_rad")

    @property
    def type(self) -> Any:
        """Type of the value in a file."""
        description = f"{self.meaning}, {self.unit}" if self.unit else self.meaning
        if isinstance(self.default, bool):
            return Annotated[bool, Meta(description=description)]
        if self.unit == SONAR_NUMBERS:
            title = f"a list of whole numbers from {self.low} to {self.high}"
            meta = Meta(title=title, description=self.meaning, extra_json_schema={"uniqueItems": True})
            return Annotated[tuple[Annotated[int, Meta(ge=self.low, le=self.high)], ...], meta]
        if not isinstance(self.default, tuple):
            return Annotated[float, Meta(ge=self.low, le=self.high, description=description)]
        count = len(self.default)
        title = "a list of numbers, one for each sonar" if self.max_length else f"a list of {count} numbers"
        least, most = (1, self.max_length) if self.max_length else (count, count)
        meta = Meta(min_length=least, max_length=most, title=title, description=description)
        return Annotated[tuple[Annotated[float, Meta(ge=self.low, le=self.high)], ...], meta]

    def from_file(self, value: Any) -> Any:
        """Return a value of a file in the simulation's units. Raises InvalidValue."""
        if self.unit == SONAR_NUMBERS:
            if len(set(value)) < len(value):
                raise InvalidValue(f"expected each number once, found {list(value)}", f"{self.table}.{self.name}")
            return tuple(sorted(value))
        return radians(value) if self.in_degrees else value

    def of(self, setup: object) -> object:
        """Return a setup's value in the simulation's units; None where its sonar model has no such setting."""
        return getattr(getattr(setup, self.table) if self.table else setup, self.field, None)

    def check(self, setup: object) -> None:
        """Raise InvalidValue if a setup's value is not one that a file may contain."""
        value: Any = self.of(setup)
        if value is not None:
            # Bounds in degrees are still exact after the conversion to radians and back.
            convert(degrees(value) if self.in_degrees else value, self.type, f"{self.table}.{self.name}")


def setting(default: Any, low: float, high: float, unit: str, meaning: str, former: str = "",
            max_length: int = 0) -> Any:
    """Return a dataclass field that is a setting; arguments as in `Key`."""
    key = Key("", "", low, high, unit, meaning, former, max_length=max_length)
    return field(default=default, metadata={_SETTING: key})


def keys_of(table: str, kind: type, sonar_model: str = "") -> tuple[Key, ...]:
    """Return the keys of a dataclass, in the order of its fields."""
    return tuple(
        row.metadata[_SETTING]._replace(table=table, field=row.name, sonar_model=sonar_model, default=row.default)
        for row in fields(kind) if _SETTING in row.metadata
    )  # fmt: skip
