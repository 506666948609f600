"""A time series as CSV: columns named by quantity and unit, converted to the units that the caller chooses.

    first line     names, in any order: time_s, x_in, heading_deg, sonar_0_mm ...
    other lines    numbers; an empty field has no value; empty lines and lines that begin with # do not count

`nomad convert` (convert.py) leaves out columns that it does not know, a log for the filter (localization/live/log.py)
refuses them.
"""

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Final

from nclient.errors import RecordingError

SONAR: Final = "sonar_"

Units = Mapping[str, Mapping[str, float]]
"""Factors by quantity and unit; the quantity `sonar_` is that of all sonars, the unit "" is none."""


class TimeSeries:
    """The columns of a time series, and its rows.

    Parameters
    ----------
    text
        The whole file.
    name
        Its name, for errors.
    units
        The quantities that are read, with the factors of their units.

    Attributes
    ----------
    quantities : tuple[str, ...]
        The quantities of all columns that are read: each once.
    unknown : list[str]
        Names of columns of other quantities or units.
    sonars : int
        Number of sonars, which count from 0 without a gap.

    Raises
    ------
    RecordingError
        If it is no CSV, a quantity occurs twice, or a sonar is missing.
    """

    def __init__(self, text: str, name: str, units: Units) -> None:
        self._name = name
        self._reader = csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#"))
        titles = [field.strip() for field in next(self._fields(), [])]
        # 1. Quantity and factor of each column; None of one that is not read.
        self._columns = [_column(title, units) for title in titles]
        self.unknown = [title for title, column in zip(titles, self._columns, strict=True) if column is None]
        self.quantities = tuple(column[0] for column in self._columns if column)
        # 2. Each once, sonars without a gap.
        for quantity, times in Counter(self.quantities).items():
            if times > 1:
                raise RecordingError(f"{name}: column {quantity} occurs {times} times; expected once")
        self.sonars = sum(quantity.startswith(SONAR) for quantity in self.quantities)
        for number in range(self.sonars):
            if f"{SONAR}{number}" not in self.quantities:
                raise RecordingError(
                    f"{name}: has no column {SONAR}{number} and {self.sonars} sonars; they count from 0 without a gap"
                )

    def rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield the number of each line, the names being line 1, and its values by quantity without empty fields.

        Raises
        ------
        RecordingError
            If a field is no finite number. The range of a sonar may be infinite: no echo.
        """
        for number, fields in enumerate(self._fields(), 2):
            values = {}
            for column, field in zip(self._columns, fields, strict=False):
                if column and field.strip():
                    quantity, factor = column
                    values[quantity] = self._number(field, quantity, number) * factor
            yield number, values

    def _fields(self) -> Iterator[list[str]]:
        try:
            yield from self._reader
        except csv.Error as error:
            raise RecordingError(f"{self._name}: no CSV ({error})") from None

    def _number(self, field: str, quantity: str, row: int) -> float:
        try:
            value = float(field)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) and not (quantity.startswith(SONAR) and value == math.inf):
            raise RecordingError(f"{self._name}: row {row}: {quantity} is {field!r:.100}; expected a number")
        return value


def _column(name: str, units: Units) -> tuple[str, float] | None:
    """Return quantity and factor of a column."""
    quantity, _, unit = name.rpartition("_") if name not in units else (name, "", "")
    is_sonar = quantity.startswith(SONAR) and quantity.removeprefix(SONAR).isdecimal()
    factor = units.get(SONAR if is_sonar else quantity, {}).get(unit)
    return None if factor is None else (quantity, factor)
