"""Conversion of drives between files: formats by suffix or content, CSV and CARMEN logs, one table of all formats.

    suffix           format                                   carries
    .log .jsonl      recording of this project                all bytes
    .mcap            MCAP with ROS 2 messages                 drive, and the lines of a recording
    .bag             ROS 1 bag                                drive, and the lines of a recording
    none (a folder)  ROS 2 bag                                drive, and the lines of a recording
    .csv             time series, as `nomad localize --from`  pose, turret, velocities, sonars, bumpers
    .clf .carmen     CARMEN log: ODOM, SONAR (FLASER)         pose, turret, velocities, sonars

A file is read by its content, since `.log` is the suffix of many. What a format cannot hold is in `Drive.omitted`.
MCAP and bags need the extra `ros` (nclient/recording/ros.py).
"""

import codecs
import csv
import math
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Final

from nclient.common.files import read_errors_as, write_errors_as
from nclient.errors import ExtraMissing, RecordingError, install_hint
from nclient.protocol.types import M_PER_IN, MAX_SONAR_IN
from nclient.recording.drive import RING, Drive, Sample, drive_of_recording, recording_of_drive, ring_of
from nclient.recording.format import FORMAT, escape_controls, parse_recording
from nclient.transports.stream import on_error

RECORDING, MCAP, BAG, BAG2, CSV, CARMEN = "recording", "MCAP", "ROS 1 bag", "ROS 2 bag", "CSV", "CARMEN log"
SUFFIXES: Final = {
    ".log": RECORDING, ".jsonl": RECORDING, ".mcap": MCAP, ".bag": BAG, "": BAG2, ".csv": CSV, ".clf": CARMEN,
    ".carmen": CARMEN,
}
MAX_BYTES: Final = 1 << 30
"""Larger text files are refused: they are read as a whole."""
MAX_VALUE: Final = 1e8
"""Limit of metres and radians: what is beyond it is damaged, and fits no message of a Nomad."""
MAX_NAMES: Final = 20
"""Names of unknown columns or messages that are listed; a damaged file has thousands."""
_MAX_TIME_S: Final = 2.0**31
"""Seconds since 1970 that all formats hold: messages of ROS 2 until 2038."""
_ROS: Final = (MCAP, BAG, BAG2)


# -- time series as CSV: columns named by quantity and unit -------------------------------------------------------

SONAR: Final = "sonar_"

Units = Mapping[str, Mapping[str, float]]
"""Factors by quantity and unit; the quantity `sonar_` is that of all sonars, the unit "" is none."""


class TimeSeries:
    """The columns of a time series, and its rows.

    first line     names, in any order: time_s, x_in, heading_deg, sonar_0_mm ...
    other lines    numbers; an empty field has no value; empty lines and lines that begin with # do not count

    `nomad convert` leaves out columns that it does not know, a log for the filter (localization/live/run.py) refuses
    them.

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


# -- formats -----------------------------------------------------------------------------------------------------

def format_to_write(path: Path) -> str:
    """Return the format of a new file by its suffix. Raises RecordingError if no format has it, or the file exists."""
    if path.suffix.lower() not in SUFFIXES:
        names = ", ".join(f"{suffix or 'no suffix'} ({name})" for suffix, name in SUFFIXES.items())
        raise RecordingError(f"{path}: no format has the suffix {path.suffix!r}; there are {names}")
    if path.exists():
        raise RecordingError(f"{path}: exists; remove it or give another name")
    return SUFFIXES[path.suffix.lower()]


def format_of_file(path: Path) -> str:
    """Return the format of a file by its first bytes. Raises RecordingError if it is none of them."""
    with read_errors_as(RecordingError, path):
        if path.is_dir():
            if (path / "metadata.yaml").exists():
                return BAG2
            raise RecordingError(f"{path}: a folder without metadata.yaml; a ROS 2 bag has one")
        with path.open("rb") as file:
            start = file.read(4096)
    # 1. Binary formats have a magic number, recordings a header.
    if start.startswith(b"\x89MCAP"):
        return MCAP
    if start.startswith(b"#ROSBAG V2"):
        return BAG
    if start.lstrip().startswith(b"{") and FORMAT.encode() in start:
        return RECORDING
    # 2. Text: column names of a time series, or the lines of a CARMEN log.
    start = start.removeprefix(codecs.BOM_UTF8)  # as spreadsheets write it
    lines = [line for line in start.decode("latin-1").splitlines() if line.strip() and not line.startswith("#")]
    first = lines[0].split(",")[0].strip() if lines else ""
    if any(name.strip() in ("time_s", "time_ms") for name in (lines[0].split(",") if lines else ())):
        return CSV
    if start.startswith(b"# CARMEN") or first.split(" ")[0] in ("PARAM", "ODOM", "FLASER", "SONAR", "SYNC"):
        return CARMEN
    raise RecordingError(f"{path}: is no recording, MCAP, ROS bag, CARMEN log or CSV with a column time_s")


def is_recording(path: Path) -> bool:
    """Return True for a recording of this project, or a file of no format that is read here.

    Reading such a file as a recording explains what is wrong.
    """
    try:
        return format_of_file(path) == RECORDING
    except RecordingError:
        return True


def may_be_drive(path: Path, or_csv: bool = False) -> bool:
    """Return True if a file is of a format that has a drive, CSV only with `or_csv`."""
    try:
        return format_of_file(path) != CSV or or_csv
    except RecordingError:
        return False


def read_drive(path: Path, fields: Sequence[str] = ()) -> Drive:
    """Read a drive from a file of any format.

    Parameters
    ----------
    path
        The file, or the folder of a ROS 2 bag.
    fields
        For bags and MCAP with messages of other types: `column=topic:place`, such as `x_m=/state:raw.0`.

    Raises
    ------
    RecordingError
        If it cannot be read or has no drive.
    ExtraMissing
        If the format needs an extra that is not installed.
    """
    name = format_of_file(path)
    if fields and name not in _ROS:
        raise RecordingError(f"{path}: --field is for bags and MCAP; this is a {name}")
    if name in _ROS:
        drive: Drive = _ros().read(path, name, fields)
    else:
        text = _read_text(path)
        match name:
            case "recording":
                drive = drive_of_recording(parse_recording(text, str(path)), text.removesuffix("\n").split("\n"))
            case "CSV":
                drive = read_csv(text, str(path))
            case _:
                drive = read_carmen(text, str(path))
    if not drive.samples:
        raise RecordingError(f"{path}: has no pose and no sonars; nothing to read" + _because(drive))
    _check(drive, path)
    return drive


def write_drive(drive: Drive, path: Path) -> None:
    """Write a drive to a file in the format of its suffix; add what the format cannot hold to `drive.omitted`.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    name = format_to_write(path)
    drive.omitted += _not_held(drive, name)
    lines_of = {RECORDING: recording_of_drive, CSV: csv_lines, CARMEN: carmen_lines}
    with write_errors_as(RecordingError, path), on_error(lambda: _remove(path)):
        if name in lines_of:
            path.write_text("".join(f"{line}\n" for line in lines_of[name](drive)), encoding="utf-8")
        else:
            _ros().write(drive if _has_equal_angles(drive) else _without_ranges(drive), path, name)


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _not_held(drive: Drive, name: str) -> Iterator[str]:
    """Yield what this drive has and the format cannot hold."""
    if name in (CSV, CARMEN):
        if drive.traffic:
            yield "the bytes between program and robot, and replies other than pose, sonars and bumpers"
        if any(sample.volts for sample in drive.samples):
            yield "battery voltages"
        if drive.start_s and name == CSV:
            yield "the date of the start"
    if name == CSV and drive.directions_rad != RING:
        yield "directions of the sonars (give them to nomad localize in a model file)"
    if name == CARMEN and any(sample.bumpers for sample in drive.samples):
        yield "bumpers"
    if name in _ROS and not _has_equal_angles(drive):
        yield "sonars: a LaserScan needs equal angles between them (a CARMEN log holds them)"
    if name == RECORDING and not drive.traffic:
        if any(sample.volts for sample in drive.samples):
            yield "battery voltages"
        if any(MAX_SONAR_IN * M_PER_IN < range_m < math.inf for sample in drive.samples for range_m in sample.ranges_m):
            yield f"ranges beyond {MAX_SONAR_IN} in, which read as no echo"
        if drive.directions_rad != RING:
            count = len(drive.directions_rad)
            yield f"the ring of {count} sonars: each of a Nomad's 16 has the nearest within 11 degrees"
        yield "parts of inches of the sonars, of 0.1 in and 0.1 degrees of the pose"


def _because(drive: Drive) -> str:
    if not drive.omitted:
        return ""
    found = ", ".join(map(escape_controls, drive.omitted))
    return f"; it has {found}: name their numbers with --field (nomad help convert)"


def _check(drive: Drive, path: Path) -> None:
    """Check that all numbers of a drive can be written to any format. Raises RecordingError."""
    if not 0 <= drive.start_s < _MAX_TIME_S:
        raise RecordingError(f"{path}: starts at {drive.start_s:g} s; expected seconds since 1970")
    sonars = len(drive.directions_rad)
    for number, sample in enumerate(drive.samples, 1):
        values = (sample.x_m, sample.y_m, sample.heading_rad, sample.turret_rad or 0.0, sample.speed_m_s,
                  sample.turn_rad_s)
        is_valid = abs(sample.time_s) < _MAX_TIME_S and all(abs(value) < MAX_VALUE for value in values)
        # NaN is above nothing.
        if not is_valid or not all(range_m > -math.inf for range_m in sample.ranges_m):
            raise RecordingError(f"{path}: sample {number} has no numbers of a robot: {sample!r:.300}")
        if sample.ranges_m and len(sample.ranges_m) != sonars:
            raise RecordingError(f"{path}: sample {number} has {len(sample.ranges_m)} sonars; the first has {sonars}")


def _has_equal_angles(drive: Drive) -> bool:
    """Return True if the sonars are at equal angles, as the readings of a LaserScan are."""
    angles = drive.directions_rad
    steps = [math.remainder(after - before, math.tau) for before, after in pairwise(angles)]
    return all(math.isclose(step, steps[0], abs_tol=1e-3) for step in steps)


def _without_ranges(drive: Drive) -> Drive:
    return replace(drive, samples=[sample._replace(ranges_m=()) for sample in drive.samples])


def _ros() -> ModuleType:
    """Return the module for MCAP and bags. Raises ExtraMissing without its extra."""
    try:
        from nclient.recording import ros
    except ModuleNotFoundError as error:
        raise ExtraMissing(f"MCAP and ROS bags need {error.name}: {install_hint(error.name or '')}") from error
    return ros


def _read_text(path: Path) -> str:
    with read_errors_as(RecordingError, path):
        if path.stat().st_size > MAX_BYTES:
            raise RecordingError(f"{path}: larger than {MAX_BYTES >> 20} MB; split it")
        return path.read_text(encoding="utf-8-sig", errors="replace")


# -- CSV --------------------------------------------------------------------------------------------------------------

_M_PER: Final = {"in": M_PER_IN, "mm": 0.001, "cm": 0.01, "m": 1.0}
_RAD_PER: Final = {"deg": math.radians(1.0), "rad": 1.0}
_UNITS: Final = {"time": {"s": 1.0, "ms": 0.001}, "x": _M_PER, "y": _M_PER, "heading": _RAD_PER, "turret": _RAD_PER,
                 SONAR: _M_PER, "speed_in": {"s": M_PER_IN}, "turn_deg": {"s": math.radians(1.0)}, "bumpers": {"": 1.0}}


def csv_lines(drive: Drive) -> Iterator[str]:
    """Yield the lines of a time series in inches and degrees, as `nomad localize --from` reads it.

    Numbers have four decimals, the time nine.
    """
    sonars = [f"{SONAR}{k}_in" for k in range(len(drive.directions_rad))]
    others = ("time_s", "x_in", "y_in", "heading_deg", "turret_deg", "speed_in_s", "turn_deg_s", "bumpers")
    yield ",".join((*others, *sonars))
    for sample in drive.samples:
        turret = sample.heading_rad if sample.turret_rad is None else sample.turret_rad
        numbers = (sample.x_m / M_PER_IN, sample.y_m / M_PER_IN, math.degrees(sample.heading_rad), math.degrees(turret),
                   sample.speed_m_s / M_PER_IN, math.degrees(sample.turn_rad_s))
        ranges = sample.ranges_m or (math.inf,) * len(sonars)
        fields = [_decimal(sample.time_s, 9), *(_decimal(number, 4) for number in numbers), str(sample.bumpers)]
        # An empty field means no echo.
        yield ",".join([*fields, *("" if math.isinf(one) else _decimal(one / M_PER_IN, 4) for one in ranges)])


def _decimal(value: float, digits: int) -> str:
    """Return a number without needless zeros, and never -0."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def read_csv(text: str, name: str) -> Drive:
    """Parse a time series with the columns of `csv_lines`, in any order and with any of the units."""
    series = TimeSeries(text, name, _UNITS)
    sonars = series.sonars
    drive = Drive([], tuple(math.tau * k / sonars for k in range(sonars)) if sonars else RING)
    drive.ring_m = ring_of(drive)
    if series.unknown:
        drive.omitted.append(f"columns {_listed(series.unknown)}")
    drive.samples += [_csv_sample(values, sonars, name, number) for number, values in series.rows()]
    return drive


def _listed(names: Sequence[str]) -> str:
    """Return names as a list, and the number of those that are too many."""
    more = len(names) - MAX_NAMES
    return ", ".join(names[:MAX_NAMES]) + (f" and {more} more" if more > 0 else "")


def _csv_sample(values: dict[str, float], sonars: int, name: str, number: int) -> Sample:
    missing = [key for key in ("x", "y", "heading", "time") if key not in values]
    if missing:
        raise RecordingError(f"{name}: row {number}: has no {missing[0]}; "
                             "expected columns time_s, x_in, y_in, heading_deg")
    ranges = tuple(values.get(f"{SONAR}{k}", math.inf) for k in range(sonars))
    return Sample(values["time"], values["x"], values["y"], values["heading"], values.get("turret"),
                  values.get("speed_in", 0.0), values.get("turn_deg", 0.0), ranges, int(values.get("bumpers", 0)))


# -- CARMEN -----------------------------------------------------------------------------------------------------------

# Opening angle of a Nomad's sonar in radians: 25 degrees.
_CONE_RAD: Final = math.radians(25)
# Radius of the ring in metres, which CARMEN wants with every reading.
_RING_M: Final = 0.0
_HOST: Final = "nomad"


def carmen_lines(drive: Drive) -> Iterator[str]:
    """Yield the lines of a CARMEN log: ODOM and SONAR for each sample, in metres, radians and seconds."""
    yield "# CARMEN Logfile"
    yield "# file format is one message per line"
    yield "# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp"
    yield "# ODOM x y theta tv rv accel"
    yield "# SONAR cone_angle num_sonars [ranges] [x y theta of each sonar]"
    for sample in drive.samples:
        end = f"{drive.start_s + sample.time_s!r} {_HOST} {sample.time_s!r}"
        yield (f"ODOM {sample.x_m!r} {sample.y_m!r} {sample.heading_rad!r} {sample.speed_m_s!r} "
               f"{sample.turn_rad_s!r} 0 {end}")
        if sample.ranges_m:
            turret = 0.0 if sample.turret_rad is None else sample.turret_rad - sample.heading_rad
            ranges = " ".join(repr(one) for one in sample.ranges_m)
            mounts = " ".join(f"{_RING_M} {_RING_M} {angle + turret!r}" for angle in drive.directions_rad)
            yield f"SONAR {_CONE_RAD!r} {len(sample.ranges_m)} {ranges} {mounts} {end}"


def read_carmen(text: str, name: str) -> Drive:
    """Parse a CARMEN log: poses of ODOM, ranges of SONAR, or of FLASER where it has no sonars."""
    kinds = Counter(line.split(None, 1)[0] for line in text.splitlines() if line.strip() and not line.startswith("#"))
    source = next((kind for kind in ("SONAR", "FLASER") if kinds[kind]), "ODOM")
    drive = Drive([], start_s=0.0)
    _name_skipped(drive, [item for item in kinds.items() if item[0] not in ("ODOM", "PARAM", "SYNC", source)])
    pose = Sample(0.0)
    for number, line in enumerate(text.splitlines(), 1):
        kind, *words = line.split() or [""]
        if kind not in ("ODOM", source):
            continue
        try:
            # The last three words are time, host and time of the logger.
            numbers, time_s, start_s = [float(word) for word in words[:-3]], float(words[-1]), float(words[-3])
            if kind == "ODOM":
                x, y, heading, speed, turn, _ = numbers
                pose = Sample(time_s, x, y, heading, None, speed, turn)
            elif kind == "FLASER":
                # The velocities are those of the last ODOM.
                pose = pose._replace(x_m=numbers[-3], y_m=numbers[-2], heading_rad=numbers[-1])
            if kind == source:
                drive.start_s = drive.start_s or start_s - time_s
                sample = pose._replace(time_s=time_s)
                drive.samples.append(sample if kind == "ODOM" else _with_carmen_ranges(sample, kind, numbers, drive))
        except (ValueError, IndexError, OverflowError) as error:
            raise RecordingError(f"{name}, line {number}: no {kind} message of CARMEN ({error})") from None
    # The two times of a line differ by rounding only, or that of the logger is since 1970.
    if drive.start_s < 1e-3:
        drive.start_s = 0.0
    drive.ring_m = ring_of(drive)
    return drive


def _name_skipped(drive: Drive, skipped: list[tuple[str, int]]) -> None:
    """Add kinds of messages that are not read, with their number, to what the drive leaves out."""
    drive.omitted += [f"{count} messages {kind}" for kind, count in skipped[:MAX_NAMES]]
    if len(skipped) > MAX_NAMES:
        drive.omitted.append(f"{sum(count for _, count in skipped[MAX_NAMES:])} messages of other kinds")


def _with_carmen_ranges(sample: Sample, kind: str, numbers: list[float], drive: Drive) -> Sample:
    """Return a sample with the ranges of a message; the first one gives the drive its directions."""
    ranges, directions, is_off_axis = (_carmen_sonar if kind == "SONAR" else _carmen_laser)(numbers)
    if not drive.samples:
        drive.directions_rad = _ring(directions)
        if is_off_axis:
            drive.omitted.append("places of the sonars on the robot, other than their directions")
    # A ring on a turret: all sonars turn by the same angle.
    turned = directions[0] - drive.directions_rad[0]
    turret = sample.heading_rad + turned if kind == "SONAR" else None
    return sample._replace(ranges_m=tuple(ranges), turret_rad=turret)


def _ring(directions: tuple[float, ...]) -> tuple[float, ...]:
    """Return the directions of the sonars on the turret: a Nomad's, whatever the turret's direction, or as they are."""
    if len(directions) != len(RING):
        return directions
    apart = [one - directions[0] - wanted for one, wanted in zip(directions, RING, strict=True)]
    return RING if all(abs(math.remainder(angle, math.tau)) < 1e-9 for angle in apart) else directions


def _carmen_sonar(numbers: list[float]) -> tuple[Sequence[float], tuple[float, ...], bool]:
    """Return ranges and directions of a SONAR message, and True if sonars are beside the robot's axis."""
    count = int(numbers[1])
    mounts = numbers[2 + count :]
    if len(mounts) != 3 * count:
        raise ValueError(f"{count} sonars, {len(mounts)} numbers of their places")
    return numbers[2 : 2 + count], tuple(mounts[2::3]), any(mounts[0::3]) or any(mounts[1::3])


def _carmen_laser(numbers: list[float]) -> tuple[Sequence[float], tuple[float, ...], bool]:
    """Return the same of a FLASER message."""
    # Beams of a front laser go from -90 to 90 degrees; the last six numbers are two poses.
    count = int(numbers[0])
    if len(numbers) != count + 7 or count < 2:
        raise ValueError(f"{count} readings, {len(numbers) - 7} numbers")
    return numbers[1 : 1 + count], tuple(math.pi * (k / (count - 1) - 0.5) for k in range(count)), False
