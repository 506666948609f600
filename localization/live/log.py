"""Recorded drives of any robot: a log of odometry and sonars as CSV. run.py runs a filter over it.

The first line names the columns, in any order; a column ends in its unit:

    time_s (or _ms)                             the robot's clock
    x_in, y_in, heading_deg (_mm, _m; _rad)     the pose by odometry; optional: turret_deg
    sonar_0_in, sonar_1_in ...  (_mm, _m)       the last reading of each sonar, numbered as in the ring
    truth_x_in, truth_y_in, truth_heading_deg   optional: a reference pose, for the errors only

A log has the last reading of each sonar and seldom the instant at which it fired. A reading is taken for new if it
differs from the one before, or if the sonar must have fired again since (`new_echoes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf, radians
from pathlib import Path
from typing import Final, NamedTuple

from nclient.common.hints import suggest
from nclient.errors import LogFileError, RecordingError
from nclient.protocol.types import M_PER_IN
from nclient.recording import convert
from nclient.recording.convert import SONAR, TimeSeries, Units
from worlds.rings import Ring

_IN_PER: Final = {"in": 1.0, "mm": 1.0 / 25.4, "cm": 1.0 / 2.54, "m": 1000.0 / 25.4}
_RAD_PER: Final = {"deg": radians(1.0), "rad": 1.0}
_UNITS: Final = {
    "time": {"s": 1.0, "ms": 0.001},
    **dict.fromkeys(("x", "y", "truth_x", "truth_y"), _IN_PER),
    **dict.fromkeys(("heading", "turret", "truth_heading"), _RAD_PER),
}
_REQUIRED: Final = ("time", "x", "y", "heading")
_UNUSED: Final[Units] = {"speed_in": {"s": 1.0}, "turn_deg": {"s": 1.0}, "bumpers": {"": 1.0}}
"""Columns that `nomad convert` writes besides."""
_TRUTH: Final = ("truth_x", "truth_y", "truth_heading")
MAX_BYTES: Final = 64 << 20
"""Larger logs are refused: an hour of a ring at 10 Hz takes 8 MB."""


Pose = tuple[float, float, float]
"""x and y in inches, heading of the steering in radians."""


class LogRow(NamedTuple):
    """One line of a log: inches, radians, seconds.

    Attributes
    ----------
    clock_s
        The robot's clock.
    odometry
        The pose by odometry.
    turret_rad
        Direction of the ring; that of the robot where the log has none.
    sonars_in
        The last reading of each sonar; inf for an empty field.
    truth
        The reference pose, if the log has one.
    """

    clock_s: float
    odometry: Pose
    turret_rad: float
    sonars_in: tuple[float, ...]
    truth: Pose | None = None


def read_log(file: Path) -> list[LogRow]:
    """Return the rows of a log: CSV, or any file that `nomad convert` reads.

    Raises
    ------
    LogFileError
        If it cannot be read, a column is missing or has no unit, a field is no number, or time does not increase.
    """
    if file.suffix != ".csv" and convert.may_be_drive(file):
        return _rows_of_drive(file)
    try:
        if file.stat().st_size > MAX_BYTES:
            raise LogFileError(f"{file}: larger than {MAX_BYTES >> 20} MB; split it")
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise LogFileError(f"{file}: cannot be read: {error}") from error
    try:
        series = TimeSeries(text, str(file), {**_UNITS, SONAR: _IN_PER, **_UNUSED})
        _check_columns(series, file)
        rows = [_row(values, series, file, number) for number, values in series.rows()]
    except RecordingError as error:
        raise LogFileError(str(error)) from None
    return _checked(rows, file)


def _rows_of_drive(file: Path) -> list[LogRow]:
    """Return the rows of a recording, bag, MCAP or CARMEN log."""
    try:
        drive = convert.read_drive(file)
    except RecordingError as error:
        raise LogFileError(str(error)) from None
    rows = [
        LogRow(
            sample.time_s, (sample.x_m / M_PER_IN, sample.y_m / M_PER_IN, sample.heading_rad),
            sample.heading_rad if sample.turret_rad is None else sample.turret_rad,
            tuple(range_m / M_PER_IN for range_m in sample.ranges_m),
        )
        for sample in drive.samples if sample.ranges_m
    ]  # fmt: skip
    return _checked(rows, file)


def _checked(rows: list[LogRow], file: Path) -> list[LogRow]:
    """Return the rows of a log. Raises LogFileError if there are too few, or time does not increase."""
    for number, (before, after) in enumerate(pairwise(rows), 3):
        if after.clock_s <= before.clock_s:
            raise LogFileError(f"{file}: row {number}: time {after.clock_s:g} s does not increase")
    if len(rows) < 2:
        raise LogFileError(f"{file}: has {len(rows)} rows; expected a line of column names and at least two rows")
    return rows


def _check_columns(series: TimeSeries, file: Path) -> None:
    """Raise LogFileError if a column is unknown, has no unit, or is missing."""
    for name in series.unknown:
        quantity = name.rpartition("_")[0]
        units = _IN_PER if quantity.startswith(SONAR) else _UNITS.get(quantity)
        if units is not None:
            raise LogFileError(f"{file}: column {name!r} has no unit; expected {quantity}_{' or _'.join(units)}")
        choices = [f"{one}_{next(iter(factors))}" for one, factors in _UNITS.items()]
        raise LogFileError(f"{file}: unknown column {name!r}; expected {', '.join(choices)}, "
                           f"{SONAR}0_in ...{suggest(name, choices)}")  # fmt: skip
    missing = [name for name in (*_REQUIRED, f"{SONAR}0") if name not in series.quantities]
    if any(name in series.quantities for name in _TRUTH):
        missing += [name for name in _TRUTH if name not in series.quantities]
    if missing:
        raise LogFileError(f"{file}: has no column {missing[0]}; expected it in the first line, with its unit")


def _row(values: dict[str, float], series: TimeSeries, file: Path, number: int) -> LogRow:
    sonars = tuple(values.pop(f"{SONAR}{sonar}", inf) for sonar in range(series.sonars))
    # Of all other columns each row has a value.
    for name in series.quantities:
        if name not in values and not name.startswith(SONAR) and name not in _UNUSED:
            raise LogFileError(f"{file}: row {number}: {name} is ''; expected a number")
    heading = values["heading"]
    truth = (values["truth_x"], values["truth_y"], values["truth_heading"]) if _TRUTH[0] in values else None
    return LogRow(values["time"], (values["x"], values["y"], heading), values.get("turret", heading), sonars, truth)


def new_echoes(readings: Sequence[Sequence[float]], clocks_s: Sequence[float], period_s: float) -> list[list[int]]:
    """Return for each row of a log the sonars whose reading is new: none of the first.

    A reading that differs from the last one is new. One that stays is new once `period_s`, in which a sonar fires
    again, has passed since it was last new: each echo counts once, also at a smooth wall.
    """
    new: list[list[int]] = [[] for _ in readings]
    since = [clocks_s[0]] * len(readings[0])
    for row in range(1, len(readings)):
        for sonar, reading in enumerate(readings[row]):
            if reading != readings[row - 1][sonar] or clocks_s[row] - since[sonar] >= period_s:
                since[sonar] = clocks_s[row]
                new[row].append(sonar)
    return new


def without_echo(rows: Sequence[LogRow], ring: Ring) -> list[LogRow]:
    """Return a log in which the reading of a ring that means "no echo" is inf.

    Raises
    ------
    LogFileError
        If the log has not as many sonars as the ring.
    """
    count = len(rows[0].sonars_in)
    if count != ring.count:
        raise LogFileError(f"the log has {count} sonars, the ring {ring.count}: name the columns {SONAR}0 to "
                           f"{SONAR}{ring.count - 1}, or give the model of this robot")  # fmt: skip
    near_in = 0.1 * ring.resolution_in  # a log has rounded numbers
    return [
        row._replace(sonars_in=tuple(inf if abs(each - ring.no_echo_in) < near_in else each for each in row.sonars_in))
        for row in rows
    ]
