"""Inputs of the live filter from a robot's state: corrected readings, instants of new echoes, past encoder poses.

RobotState --> corrected (calibration) --> Localizer.update
FiringSchedule    the sonar and instant of each echo that a state shows for the first time
PoseHistory       the encoders at that instant, by interpolation between polled states

Recorded drives of any robot: a log of odometry and sonars as CSV. `live.run` runs a filter over it.

The first line names the columns, in any order; a column ends in its unit:

    time_s (or _ms)                             the robot's clock
    x_in, y_in, heading_deg (_mm, _m; _rad)     the pose by odometry; optional: turret_deg
    sonar_0_in, sonar_1_in ...  (_mm, _m)       the last reading of each sonar, numbered as in the ring
    truth_x_in, truth_y_in, truth_heading_deg   optional: a reference pose, for the errors only

A log has the last reading of each sonar and seldom the instant at which it fired. A reading is taken for new if it
differs from the one before, or if the sonar must have fired again since (`new_echoes`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import floor, inf, radians
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import HEADING, POSE, Belief, Floats, wrap_angle
from localization.filters.odometry import with_parameters
from nclient.common.files import read_errors_as
from nclient.errors import AddressError, LogFileError, RecordingError, RobotRefused, suggest
from nclient.protocol.types import M_PER_IN, MAX_SONAR_IN, MIN_SONAR_IN, SONAR_RATE_STEP_S, SONAR_SLOTS
from nclient.recording import convert
from nclient.recording.convert import SONAR, TimeSeries, Units
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.rings import Ring
from worlds.robots import IDEAL_CALIBRATION, N150, Calibration


@dataclass(frozen=True, slots=True)
class SensorData:
    """The part of a robot's state that the filter uses, with values of its own. Seconds, inches, radians."""

    clock_s: float | None
    x_in: float
    y_in: float
    steering_rad: float
    turret_rad: float
    sonars_in: tuple[float, ...]
    touching: bool = False


SensorInput = RobotState | SensorData
"""What the filter uses of a robot's state."""


def with_readings(state: SensorInput, sonars_in: tuple[float, ...], turret_rad: float | None = None) -> SensorData:
    """Return a state with other sonar readings and, if given, another turret angle."""
    turret = state.turret_rad if turret_rad is None else turret_rad
    return SensorData(state.clock_s, state.x_in, state.y_in, state.steering_rad, turret, sonars_in, state.touching)


def sonar_readings(state: SensorInput) -> tuple[float, ...]:
    """Return the readings of all sonars: of the ring of a model file, where the robot reports them, or State's."""
    ring_in = state.ring_in if isinstance(state, RobotState) else None
    return state.sonars_in if ring_in is None else ring_in


# Calibration.

_INSIDE_IN: Final = 1e-3
"""A corrected reading stays this much within the limits."""


def corrected(state: SensorInput, calibration: Calibration, ring: Ring = N150.ring) -> SensorInput:
    """Return a state without the systematic errors of its sonars and of the mounting of their ring.

    Limits of a ring other than a Nomad's become those of a Nomad, or remain if they are beyond: they are limits then
    for every part of a filter.
    """
    if ring is N150.ring and calibration is IDEAL_CALIBRATION:
        return state
    readings = sonar_readings(state)
    is_other = ring is not N150.ring and _limits(ring) != _limits(N150.ring)
    if is_other:
        readings = tuple([_limited(reading, ring) for reading in readings])
    if is_other or not ring.fits_state:
        state = with_readings(state, readings)
    if calibration is IDEAL_CALIBRATION:
        return state
    pairs = zip(readings, calibration.offsets_in, strict=False)
    sonars = tuple(_corrected_reading(reading_in, offset_in, ring) for reading_in, offset_in in pairs)
    return with_readings(state, sonars, state.turret_rad + calibration.turned_rad)


def _limits(ring: Ring) -> tuple[float, float, float]:
    return ring.min_range_in, ring.max_range_in, ring.no_echo_in


def _limited(reading_in: float, ring: Ring) -> float:
    if reading_in == ring.no_echo_in or reading_in >= ring.max_range_in:
        return max(ring.max_range_in, MAX_SONAR_IN)
    return min(reading_in, MIN_SONAR_IN) if reading_in <= ring.min_range_in else reading_in


def with_wheels(pose: Belief, calibration: Calibration) -> Belief:
    """Return a belief over poses (3,) extended by calibrated odometry parameters; unchanged for a faultless robot."""
    if calibration is IDEAL_CALIBRATION:
        return pose
    spread = calibration.spread
    belief = with_parameters(pose, (spread.distance_scale, spread.turn_scale, spread.drift_rad_in))
    belief.mean[POSE:] = calibration.distance_scale - 1.0, calibration.turn_scale - 1.0, calibration.drift_rad_in
    return belief


def _corrected_reading(reading_in: float, offset_in: float, ring: Ring) -> float:
    """Return a reading less its offset; a limit is no range and stays as it is."""
    if not ring.min_range_in < reading_in < ring.max_range_in:
        return reading_in
    return min(max(reading_in - offset_in, ring.min_range_in + _INSIDE_IN), ring.max_range_in - _INSIDE_IN)


# New echoes.

CLOCK_STEP_S = 0.0164
"""Step of a robot's clock: an instant is past for certain only one step later."""
_TINY = 1e-9
"""Rounding of a number of intervals."""


class FiringTime(NamedTuple):
    """A sonar that fired, and the instant by the robot's clock."""

    sonar: int
    instant_s: float


@dataclass(frozen=True, slots=True)
class FiringSchedule:
    """Instants at which the sonars of a ring fire.

    A restart of the ring begins at the clock of its answer; entry k of the order fires k intervals later, and so on in
    turn. A state shows the last reading of each sonar without its instant; order and clock tell which are new.

    Attributes
    ----------
    start_s
        Clock of the restart.
    interval_s
        Seconds from one entry to the next.
    firing
        Sonars that fire at once, entry by entry, each at most once. Defaults: those of a Nomad.
    """

    start_s: float
    interval_s: float = N150.ring.interval_s
    firing: tuple[tuple[int, ...], ...] = N150.ring.firing

    @classmethod
    def of_command(cls, start_s: float, rate: int, order: Iterable[int]) -> FiringSchedule:
        """Return the schedule that conf_sn sets."""
        return cls(start_s, rate * SONAR_RATE_STEP_S, tuple((sonar,) for sonar in order))

    @property
    def order(self) -> tuple[int, ...]:
        """Sonar numbers in the order of firing."""
        return tuple(sonar for group in self.firing for sonar in group)

    @property
    def round_s(self) -> float:
        """Seconds until the same sonar fires again."""
        return self.interval_s * len(self.firing)

    def readable(self, after_s: float, now_s: float, late_s: float = 0.0) -> list[FiringTime]:
        """Return the firings later than `after_s` whose echoes a state of clock `now_s` certainly shows, in order.

        An echo is readable until its sonar may have fired again. The clock may be late by up to `late_s`: a sonar that
        should have fired by it may not have yet.
        """
        start_s, interval_s, firing = self.start_s, self.interval_s, self.firing
        # 1. The last that is certainly past.
        last = floor((now_s - late_s - CLOCK_STEP_S - start_s) / interval_s + _TINY)
        # 2. The first that is later than `after_s`, and not yet overwritten.
        overwritten_s = now_s + CLOCK_STEP_S - interval_s * len(firing)
        after = floor((after_s - start_s) / interval_s + _TINY) if after_s >= start_s else -1
        overwritten = floor((overwritten_s - start_s) / interval_s + _TINY)
        first = (after if after > overwritten else max(overwritten, -1)) + 1
        # 3. All between them.
        firings = []
        for k in range(first, last + 1):
            instant_s = start_s + k * interval_s
            for sonar in firing[k % len(firing)]:
                firings.append(FiringTime(sonar, instant_s))
        return firings


def restart_ring(robot: Robot, ring: Ring) -> tuple[FiringSchedule, RobotState]:
    """Restart the sonars of a robot, so that their firing times are known; return these and a state.

    A ring that State and conf_sn have room for is restarted by conf_sn; any other by the ring packet of a simulation,
    and from then on the robot's states have all its sonars.

    Raises
    ------
    AddressError
        If the robot has no such packet.
    """
    if ring.fits_state:
        state = robot.configure_sonars(rate=ring.rate, order=[sonar for (sonar,) in ring.firing])
        assert state.clock_s is not None
        return FiringSchedule(state.clock_s, ring.interval_s, ring.firing), state
    try:
        readings = robot.watch_ring()
    except RobotRefused:
        raise AddressError(
            f"State has {SONAR_SLOTS} sonars that fire one at a time, in whole inches from {MIN_SONAR_IN} to "
            f"{MAX_SONAR_IN}, and this robot cannot report others: describe its ring so in the model file"
        ) from None
    return FiringSchedule(readings.clock_s, ring.interval_s, ring.firing), robot.refresh()


# Past encoder poses.

MAX_GAP_S = 0.5
"""Beyond this, the path between two states is no single arc any more, and the estimate becomes overconfident."""
HISTORY_S = 2.0
"""Longer than a ring takes, so that every readable echo has its pose."""


class EncoderPose(NamedTuple):
    """The encoders at an instant: position, heading of the steering, angle of the turret."""

    clock_s: float
    x_in: float
    y_in: float
    heading_rad: float
    turret_rad: float

    @classmethod
    def of(cls, clock_s: float, pose: Floats, turret_rad: float) -> EncoderPose:
        """Return the encoders at a pose (3,)."""
        x, y, heading = pose.tolist()
        return cls(clock_s, x, y, heading, turret_rad)

    @property
    def pose(self) -> Floats:
        """x_in, y_in and heading in radians, (3,)."""
        return np.array(self[1 : 2 + HEADING])


PRESSED_IN_S: Final = 2.0
"""Wheels that roll slower than this with a closed bumper roll on the spot: a robot that drives away is faster."""


class SlipCorrection:
    """Leaves out what the wheels of a robot roll on the spot that presses against an obstacle."""

    def __init__(self) -> None:
        self._last: SensorInput | None = None
        self._x_in = self._y_in = 0.0
        self.rolled_in = 0.0
        """Distance that was rolled on the spot up to the last state, from the one before."""

    def position_of(self, state: SensorInput) -> tuple[float, float]:
        """Return x and y of the encoders without the distance that was rolled on the spot, inches."""
        last, self._last = self._last, state
        self.rolled_in = 0.0
        if last is not None and state.touching and last.touching:
            dx, dy = state.x_in - last.x_in, state.y_in - last.y_in
            passed_s = (state.clock_s or 0.0) - (last.clock_s or 0.0)
            distance_in = math.hypot(dx, dy)
            if distance_in <= PRESSED_IN_S * passed_s:
                self.rolled_in = distance_in
                self._x_in += dx
                self._y_in += dy
        return float(state.x_in) - self._x_in, float(state.y_in) - self._y_in


HEADING_ARM_IN: Final = 10.0
"""A turn counts as the distance that a point so far from the axis moves."""
MIN_MOTION_IN: Final = 0.2
"""A robot that moves less from one state to the second next does not show the errors of its clock."""
MAX_CLOCK_ERROR_S: Final = 0.1
"""A larger error is a change of the motion."""
CLOCK_MEMORY: Final = 0.05
"""Weight of the last error in the mean: of some twenty states."""


def clock_error(before: EncoderPose, middle: EncoderPose, after: EncoderPose) -> float:
    """Return how late the clock of the second of three poses is, if the robot moves evenly; 0 if it hardly moves.

    The encoders are interpolated to its clock: what lies ahead of them along the way, over the speed.
    """
    since_s, x, y, heading, _ = before
    middle_s, middle_x, middle_y, middle_heading, _ = middle
    after_s, after_x, after_y, after_heading, _ = after
    # 1. The length of the motion, its turn as a distance.
    dx, dy, turn = after_x - x, after_y - y, wrap_angle(after_heading - heading)
    squared = dx * dx + dy * dy + (HEADING_ARM_IN * turn) ** 2
    if squared <= MIN_MOTION_IN**2:
        return 0.0
    # 2. What the middle one lacks of its part of it, along it.
    passed_s = after_s - since_s
    fraction = (middle_s - since_s) / passed_s
    error = dx * (fraction * dx - (middle_x - x)) + dy * (fraction * dy - (middle_y - y))
    error += HEADING_ARM_IN**2 * turn * (fraction * turn - wrap_angle(middle_heading - heading))
    return passed_s * error / squared


class PoseHistory:
    """The encoder poses of the last seconds, and how evenly their clock advances."""

    def __init__(self) -> None:
        self._poses: list[EncoderPose] = []
        self.clock_std_s = 0.0
        """Standard deviation of the clock of a state, from the motion of the encoders (`clock_error`)."""

    @property
    def is_uneven(self) -> bool:
        """True if the clocks of the states err by more than a step of a robot's clock."""
        return self.clock_std_s > CLOCK_STEP_S

    @property
    def clock_late_s(self) -> float:
        """Return by how much the clock of a state may be late, if it is uneven: evenly distributed from 0 to this."""
        return math.sqrt(12.0) * self.clock_std_s if self.is_uneven else 0.0

    @property
    def clock_rms_s(self) -> float:
        """Return the root mean square of such a lateness, w / sqrt(3): the motion does not show its mean."""
        return self.clock_late_s / math.sqrt(3.0)

    @property
    def latest(self) -> EncoderPose:
        """The last pose."""
        return self._poses[-1]

    def add(self, pose: EncoderPose, touching: bool = False) -> None:
        """Append a pose later than all others; drop those older than HISTORY_S.

        Wheels of a robot that touches something stand and slip by turns: this shows nothing of the clock.
        """
        poses = self._poses
        poses.append(pose)
        if len(poses) > 2 and not touching:
            # The mean absolute value of three clocks' error, in these weights, is nearly the deviation of one.
            late_s = abs(clock_error(poses[-3], poses[-2], pose))
            if late_s:
                self.clock_std_s += CLOCK_MEMORY * (min(late_s, MAX_CLOCK_ERROR_S) - self.clock_std_s)
        while len(poses) > 2 and poses[1][0] < pose[0] - HISTORY_S:
            del poses[0]

    def since(self, instant_s: float) -> list[EncoderPose]:
        """Return the poses from the last one before an instant."""
        poses = self._poses
        # Two at least, to interpolate between them.
        first = max(len(poses) - 2, 0)
        while first > 0 and poses[first][0] >= instant_s:
            first -= 1
        return poses[first:]


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
    is_drive = file.suffix != ".csv" and convert.may_be_drive(file)
    try:
        rows = _rows_of_drive(file) if is_drive else _rows_of_csv(file)
    except RecordingError as error:
        raise LogFileError(str(error)) from None
    for number, (before, after) in enumerate(pairwise(rows), 3):
        if after.clock_s <= before.clock_s:
            raise LogFileError(f"{file}: row {number}: time {after.clock_s:g} s does not increase")
    if len(rows) < 2:
        raise LogFileError(f"{file}: has {len(rows)} rows; expected a line of column names and at least two rows")
    return rows


def _rows_of_csv(file: Path) -> list[LogRow]:
    """Return the rows of a CSV file."""
    with read_errors_as(LogFileError, file):
        if file.stat().st_size > MAX_BYTES:
            raise LogFileError(f"{file}: larger than {MAX_BYTES >> 20} MB; split it")
        text = file.read_text(encoding="utf-8-sig")
    series = TimeSeries(text, str(file), {**_UNITS, SONAR: _IN_PER, **_UNUSED})
    _check_columns(series, file)
    return [_row(values, series, file, number) for number, values in series.rows()]


def _rows_of_drive(file: Path) -> list[LogRow]:
    """Return the rows of a recording, bag, MCAP or CARMEN log."""
    return [
        LogRow(sample.time_s, (sample.x_m / M_PER_IN, sample.y_m / M_PER_IN, sample.heading_rad),
               sample.heading_rad if sample.turret_rad is None else sample.turret_rad,
               tuple(range_m / M_PER_IN for range_m in sample.ranges_m))
        for sample in convert.read_drive(file).samples if sample.ranges_m
    ]  # fmt: skip


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
