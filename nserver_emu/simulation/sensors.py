"""The compass of the turret, and the infrared ring and the laser of the Nomad 200. Poses and time are passed in.

The compass on the turret: ten readings a second, a magnetic deviation, and the calibration turn that removes it.

A reading is the direction of the turret in the world, counter-clockwise, 0 along the x axis (an assumption: worlds have
no north). Time and directions are passed in.

    mode 0 off: the last reading remains    1 on    2 calibrating: done after a full turn of the turret, then mode 1

A full turn is one by the motor from the angle where calibration began, in either direction; turning to and fro is none.

The infrared ring of the N200: proximity in sixteen steps. Poses and time are passed in.

    reading = whole inches from the body, 0..15; 15 means nothing, and nothing is detected beyond 24 in in any case
    history h = 0..9: a reading is h tenths of the previous one and the rest the new one; more counts as 9

The whole ring flashes at once, every 60 ms (both this and the arithmetic of the history are assumptions: no source
gives them). As with the sonars a flash records its pose; rays are cast when a reading is used, which changes no value.

The laser of the N200: a plane sheet of light, and the points and lines measured in it.

    482 columns over 60 degrees, column 0 the rightmost, from the front of the turret; ranges of 6 to 180 in
    points      in the robot's frame: x to the front of the turret, y to its left, from its axis, inches
    lines       neighbouring points split at gaps, then where they leave their chord; each piece fitted by least squares
    pixels      the row of the camera image, larger when nearer; 0 for nothing

The origin of the sheet and the scale of a pixel are assumptions: no source gives them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import takewhile
from math import cos, floor, inf, radians, sin, tau
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.acoustics import MIN_FACTOR, NOISE_SIGMAS, relative_std
from nserver_emu.simulation.segments import NO_STAMP, PS_PER_S, TIME_MAX_PS, Stamp, wrap_to_2pi
from nserver_emu.simulation.settings import setting
from nserver_emu.simulation.visibility import SensorPose
from worlds.geometry import BoolArray, FloatArray, near_walls, normals
from worlds.raycast_arrays import cast_discs, cast_fan, cast_rays
from worlds.rings import evenly
from worlds.robots import Body

COMPASS_INTERVAL_PS: Final = PS_PER_S // 10
"""Ten readings a second."""

_FULL_TURN_RAD: Final = tau - 1e-9
"""A turn of 360 degrees whose sums are rounded."""


class CompassMode(IntEnum):
    """The modes of conf_cp."""

    OFF = 0
    ON = 1
    CALIBRATING = 2


@dataclass(frozen=True, slots=True)
class CompassNoise:
    """Errors of the compass.

    Attributes
    ----------
    std_rad
        Standard deviation of a reading.
    deviation_rad, phase_rad
        The robot's iron adds deviation_rad sin(direction + phase_rad) until the compass is calibrated.
    """

    std_rad: float = setting(0.0, 0, 90, "deg", "standard deviation of a reading")
    deviation_rad: float = setting(
        0.0, 0, 90, "deg", "deviation by the robot's iron, until calibrated: d sin(heading + phase)"
    )
    phase_rad: float = setting(radians(40.0), -360, 360, "deg", "the phase in that")


NO_COMPASS_NOISE: Final = CompassNoise()
"""Exact readings."""


def last_reading_ps(until_ps: int) -> int:
    """Return the instant of the last reading up to an instant."""
    return until_ps // COMPASS_INTERVAL_PS * COMPASS_INTERVAL_PS


class CompassState(NamedTuple):
    """The state of a compass in a snapshot; fields as those of `Compass`."""

    mode: CompassMode
    calibrated: bool
    direction_rad: float
    read_ps: int
    swept_rad: tuple[float, float]


class Compass:
    """The compass; angles that are passed in are the turret's, unwrapped.

    Attributes
    ----------
    direction_rad
        The last reading, [0, 2 pi).
    read_ps, due_ps
        The instants of the last and of the next reading.
    """

    def __init__(self, noise: CompassNoise, direction_rad: float, now_ps: int, rng: np.random.Generator) -> None:
        self.noise = noise
        self.mode = CompassMode.ON
        self.calibrated = False
        self._rng = rng
        self._min_rad = self._max_rad = 0.0
        self.read_ps = last_reading_ps(now_ps)
        self.due_ps = self.read_ps + COMPASS_INTERVAL_PS
        self.direction_rad = wrap_to_2pi(direction_rad + self._error(direction_rad, 1))

    def to_state(self) -> CompassState:
        """Return all that changes."""
        swept_rad = self._min_rad, self._max_rad
        return CompassState(self.mode, self.calibrated, self.direction_rad, self.read_ps, swept_rad)

    def set_state(self, state: CompassState, now_ps: int) -> None:
        """Continue from a state; raise ValueError if its last reading lies in the future."""
        # The next reading follows from the time, so its number of draws is bounded.
        if not 0 <= state.read_ps <= now_ps:
            raise ValueError("a compass reading of another time")
        self.mode, self.calibrated = state.mode, state.calibrated
        self.direction_rad, self.read_ps = state.direction_rad, state.read_ps
        self._min_rad, self._max_rad = state.swept_rad
        self.due_ps = last_reading_ps(now_ps) + COMPASS_INTERVAL_PS

    def configure(self, mode: int, angle_rad: float) -> None:
        """Set the mode; raise ValueError for an unknown one. Calibration restarts its turn at this turret angle."""
        self.mode = CompassMode(mode)
        self._min_rad = self._max_rad = angle_rad

    def on_turret_moved(self, before_rad: float, after_rad: float) -> None:
        """Exclude a change of the turret's angle that is not by the motor from the calibration turn."""
        self._extend_turn(before_rad)
        self._min_rad += after_rad - before_rad
        self._max_rad += after_rad - before_rad

    def read(self, instant_ps: int, direction_rad: float, angle_rad: float) -> None:
        """Read at `due_ps` or some whole intervals later; readings skipped before it only draw their noise.

        Parameters
        ----------
        direction_rad
            True direction of the turret.
        angle_rad
            Its mechanical angle.
        """
        # 1. Every interval draws noise, so that the size of the steps changes no reading.
        skipped = (instant_ps - self.due_ps) // COMPASS_INTERVAL_PS
        self.due_ps = instant_ps + COMPASS_INTERVAL_PS
        error = self._error(direction_rad, skipped + 1)
        # 2. A switched-off compass keeps its reading.
        if self.mode is CompassMode.OFF:
            return
        # 3. Calibration ends after a full turn.
        self._extend_turn(angle_rad)
        if self.mode is CompassMode.CALIBRATING and self._max_rad - self._min_rad >= _FULL_TURN_RAD:
            self.calibrated, self.mode = True, CompassMode.ON
        # 4. The reading.
        self.read_ps = instant_ps
        self.direction_rad = wrap_to_2pi(direction_rad + error)

    def _extend_turn(self, angle_rad: float) -> None:
        if angle_rad < self._min_rad:
            self._min_rad = angle_rad
        elif angle_rad > self._max_rad:
            self._max_rad = angle_rad

    def _error(self, direction_rad: float, count: int) -> float:
        """Return the error of a reading, with the last of `count` draws: each reading has its own, used or not."""
        noise, error = self.noise, 0.0
        # Draw only with noise: an exact compass leaves its stream untouched.
        if noise.std_rad:
            error = noise.std_rad * float(self._rng.standard_normal(count)[-1])
        if noise.deviation_rad and not self.calibrated:
            error += noise.deviation_rad * sin(direction_rad + noise.phase_rad)
        return error


INFRAREDS: Final = 16
INFRARED_ANGLES_RAD: Final = evenly(INFRAREDS)
"""From the front of the turret; they do not depend on the sonars of a model."""
NOTHING: Final = 15
"""The reading without an obstacle."""
INFRARED_RANGE_IN: Final = 24.0
"""Nothing is detected beyond, whatever the calibration."""
TENTHS: Final = 10
MAX_HISTORY: Final = 9
"""With ten tenths of the previous reading, nothing new would ever be detected."""
INFRARED_INTERVAL_PS: Final = 60 * PS_PER_S // 1000
MAX_PENDING: Final = 4
"""Flashes stored while no reading is used, where the history needs all of them; then the oldest is computed."""
MANY_WALLS: Final = 100
"""With more walls a flash takes so long that it is computed in a turn of the event loop before the reply."""


@dataclass(frozen=True, slots=True)
class InfraredNoise:
    """Errors of the infrared sensors.

    A dull surface reflects cos(incidence) / range^2, from which the sensor infers range / sqrt(cos(incidence)).

    Attributes
    ----------
    range_std_relative
        Standard deviation of a range relative to it.
    slanted
        True: surfaces at an angle appear farther away, as above.
    """

    range_std_relative: float = relative_std(0.0)
    slanted: bool = setting(False, 0, 1, "", "surfaces at an angle appear farther away")

    @property
    def reach_in(self) -> float:
        """The range from which noise does not bring a reading below MAX_RANGE_IN, but for one in a billion."""
        return INFRARED_RANGE_IN / max(1.0 - NOISE_SIGMAS * self.range_std_relative, MIN_FACTOR)


NO_INFRARED_NOISE: Final = InfraredNoise()
"""Exact ranges."""


class Flash(NamedTuple):
    """A flash whose ranges have not been computed yet: its pose, a standard normal number per sensor, and the walls."""

    sensor_pose: SensorPose
    noise: FloatArray | None
    walls: FloatArray


class InfraredState(NamedTuple):
    """The state of a ring in a snapshot; fields as those of `InfraredRing`."""

    levels: tuple[float, ...]
    stamps: tuple[Stamp, ...]
    history: int
    order: tuple[int, ...]
    due_ps: int


class InfraredRing:
    """Sixteen sensors in the directions of the sonars.

    Attributes
    ----------
    due_ps
        The instant of the next flash; TIME_MAX_PS if the ring is off.
    """

    def __init__(self, body: Body, noise: InfraredNoise, walls: FloatArray, now_ps: int,
                 rng: np.random.Generator) -> None:
        self.body = body
        self.noise = noise
        self._walls = walls
        self._rng = rng
        self._levels = [float(NOTHING)] * INFRAREDS
        self._stamps = [NO_STAMP] * INFRAREDS
        self._pending: deque[Flash] = deque()
        self._history = 0
        self._order: tuple[int, ...] = tuple(range(INFRAREDS))
        self.due_ps = now_ps

    def to_state(self) -> InfraredState:
        """Return all that changes; pending ranges are computed, which changes no reading."""
        self._compute_pending()
        return InfraredState(tuple(self._levels), self.stamps, self._history, self._order, self.due_ps)

    def set_state(self, state: InfraredState, now_ps: int) -> None:
        """Continue from a state; raise ValueError if it is not one of a ring."""
        # One value per sensor, each in its range.
        if not all(len(values) == INFRAREDS for values in (state.levels, state.stamps)):
            raise ValueError("an infrared ring without 16 readings")
        if not all(0.0 <= level <= NOTHING for level in state.levels) or not 0 <= state.history <= MAX_HISTORY:
            raise ValueError("an infrared reading out of range")
        if not all(0 <= number < INFRAREDS for number in state.order):
            raise ValueError("an infrared ring with unknown sensors")
        if state.due_ps != TIME_MAX_PS and not now_ps <= state.due_ps <= now_ps + INFRARED_INTERVAL_PS:
            raise ValueError("an infrared ring of another time")
        self._levels, self._stamps = list(state.levels), list(state.stamps)
        self._history, self._order, self.due_ps = state.history, state.order, state.due_ps
        self._pending.clear()

    @property
    def readings(self) -> tuple[int, ...]:
        """The last reading of each sensor, 16 numbers 0..15."""
        self._compute_pending()
        return tuple(floor(level + 0.5) for level in self._levels)

    @property
    def stamps(self) -> tuple[Stamp, ...]:
        """The time stamp of each of those readings."""
        return tuple(self._stamps)

    def configure(self, history: int, order: Sequence[int], now_ps: int) -> None:
        """Set the history (clamped to 0..9) and the active sensors: those before the first number that is not one.

        The others keep their readings; without any sensor the ring is off. It flashes now, and every 60 ms.
        """
        self._compute_pending()
        self._order = tuple(takewhile(range(INFRAREDS).__contains__, order))
        self._history = min(max(history, 0), MAX_HISTORY)
        self.due_ps = now_ps if self._order else TIME_MAX_PS

    def flash_due(self, sensor_pose: SensorPose, stamp: Stamp) -> None:
        """Flash at this pose."""
        self.due_ps += INFRARED_INTERVAL_PS
        # Without a history only the last flash counts.
        if not self._history:
            self._pending.clear()
        elif len(self._pending) >= MAX_PENDING:
            self._compute_oldest()
        noise = self._rng.standard_normal(INFRAREDS) if self.noise.range_std_relative else None
        self._pending.append(Flash(sensor_pose, noise, self._walls))
        for number in self._order:
            self._stamps[number] = stamp

    def set_walls(self, walls: FloatArray) -> None:
        """Replace the walls (m, 4); earlier flashes still meet the previous ones."""
        self._walls = walls

    def set_noise(self, noise: InfraredNoise) -> None:
        """Replace the errors; earlier flashes have the previous ones."""
        self._compute_pending()
        self.noise = noise

    def compute_some(self) -> bool:
        """Compute one flash of several, or among many walls; return True if what is left takes little time."""
        if len(self._pending) > 1 or (self._pending and len(self._pending[0].walls) > MANY_WALLS):
            self._compute_oldest()
            return False
        return True

    def _compute_pending(self) -> None:
        while self._pending:
            self._compute_oldest()

    def _compute_oldest(self) -> None:
        """Compute the readings of the oldest flash: each depends on the previous one."""
        ranges, previous = self._ranges(self._pending.popleft()), self._history / TENTHS
        for number in self._order:
            level = float(floor(min(max(float(ranges[number]), 0.0), NOTHING) + 0.5))
            self._levels[number] = previous * self._levels[number] + (1.0 - previous) * level

    def _ranges(self, flash: Flash) -> FloatArray:
        """Return the measured ranges (16,) from the body, inches, inf where nothing is met."""
        # 1. Ranges to walls and robots.
        angles = flash.sensor_pose.turret_rad + np.array(INFRARED_ANGLES_RAD)
        directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        position, others = (flash.sensor_pose.x_in, flash.sensor_pose.y_in), flash.sensor_pose.others
        walls = near_walls(*position, self.body.radius_in + self.noise.reach_in, flash.walls)
        from_axis, rows = cast_rays(position, directions, walls)
        to_robots = cast_discs(position, directions, others)
        is_robot = to_robots < from_axis
        ranges: FloatArray = np.minimum(from_axis, to_robots) - self.body.radius_in
        is_met = ranges < inf
        # 2. The angle of incidence.
        if self.noise.slanted and is_met.any():
            facing = np.zeros_like(directions)
            is_wall = is_met & ~is_robot
            facing[is_wall] = normals(walls[rows[is_wall]])
            if is_robot.any():
                hits = np.array(position) + to_robots[is_robot, np.newaxis] * directions[is_robot]
                facing[is_robot] = _disc_normals(hits, others)
            cos_incidence = np.abs((facing[is_met] * directions[is_met]).sum(axis=1))
            ranges[is_met] /= np.sqrt(np.maximum(cos_incidence, 1e-6))
        # 3. Noise.
        if flash.noise is not None:
            ranges[is_met] *= 1.0 + self.noise.range_std_relative * flash.noise[is_met]
        return ranges


def _disc_normals(points: FloatArray, discs: FloatArray) -> FloatArray:
    """Return unit normals (k, 2) at points (k, 2), each on the rim of one of the discs (n, 3), which do not overlap."""
    offsets = points[:, np.newaxis] - discs[:, :2]
    off_rim = np.abs(np.hypot(offsets[..., 0], offsets[..., 1]) - discs[:, 2])
    nearest = off_rim.argmin(axis=1)
    normal: FloatArray = offsets[np.arange(len(points)), nearest] / discs[nearest, 2:]
    return normal


COLUMNS: Final = 482
FIELD_OF_VIEW_RAD: Final = radians(60.0)
MIN_RANGE_IN: Final = 6.0
LASER_RANGE_IN: Final = 180.0
PIXEL_IN: Final = 2880.0
"""Pixel row times range: row 480 at 6 in, row 16 at 180 in."""

ANGLES_RAD: Final = np.linspace(-FIELD_OF_VIEW_RAD / 2.0, FIELD_OF_VIEW_RAD / 2.0, COLUMNS)
"""Directions of the columns against the front of the turret, counter-clockwise."""


@dataclass(frozen=True, slots=True)
class LineFit:
    """Parameters of the line extraction.

    Attributes
    ----------
    threshold_in
        Largest distance of a line's point from its chord.
    min_points
        Fewest points of a line.
    gap_in
        Longest gap between two points of a line.
    """

    threshold_in: float = 1.0
    min_points: int = 5
    gap_in: float = 6.0


def ranges(sensor_pose: SensorPose, walls: FloatArray, body: Body) -> FloatArray:
    """Return the range of each column: (482,) inches from the front of the turret, inf for nothing in 6 to 180 in."""
    angles = sensor_pose.turret_rad + ANGLES_RAD
    # The sheet starts at the front of the body.
    x_in = sensor_pose.x_in + body.radius_in * cos(sensor_pose.turret_rad)
    start = x_in, sensor_pose.y_in + body.radius_in * sin(sensor_pose.turret_rad)
    met = cast_fan(*start, angles, walls, LASER_RANGE_IN)
    others = sensor_pose.others
    if len(others):
        directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        met = np.minimum(met, cast_discs(start, directions, others))
    measured = np.where((met >= MIN_RANGE_IN) & (met <= LASER_RANGE_IN), met, inf)
    measured.setflags(write=False)
    return measured


def points(ranges_in: FloatArray, body: Body) -> FloatArray:
    """Return the points (k, 2) of the columns with a range, in the robot's frame, from right to left."""
    met: BoolArray = ranges_in < inf
    x = body.radius_in + ranges_in[met] * np.cos(ANGLES_RAD[met])
    return np.stack((x, ranges_in[met] * np.sin(ANGLES_RAD[met])), axis=1)


def pixels(ranges_in: FloatArray) -> tuple[int, ...]:
    """Return the rows of the camera image, 482 numbers."""
    return tuple(np.rint(PIXEL_IN / ranges_in).astype(int).tolist())


def select_columns(ranges_in: FloatArray, count: int) -> FloatArray:
    """Return the ranges of `count` evenly spread columns, inf for the others; 0 or 482 and more: all."""
    if not 0 < count < COLUMNS:
        return ranges_in
    is_selected = np.zeros(COLUMNS, dtype=np.bool_)
    is_selected[np.linspace(0, COLUMNS - 1, count).round().astype(int)] = True
    return np.where(is_selected, ranges_in, inf)


def lines(scan: FloatArray, fit: LineFit) -> FloatArray:
    """Return lines (m, 4), rows x1 y1 x2 y2, through points (k, 2) that follow one another.

    References
    ----------
    Pavlidis and Horowitz, Segmentation of plane curves, IEEE Trans. Computers 23 (1974): split at the farthest point.
    """
    # 1. Runs without gaps. 2. Pieces near their chords. 3. A fit through each.
    steps = np.hypot(*np.diff(scan, axis=0).T)
    runs = np.split(scan, np.flatnonzero(steps > fit.gap_in) + 1)
    fitted = [_fit_line(piece) for run in runs for piece in _split(run, fit)]
    return np.array(fitted).reshape(-1, 4)


def _split(run: FloatArray, fit: LineFit) -> Iterator[FloatArray]:
    """Yield the run, split repeatedly where it is farthest from the chord of its ends; omit too short pieces."""
    # A stack instead of recursion: a run has up to 482 points.
    remaining = [run]
    while remaining:
        piece = remaining.pop()
        if len(piece) < max(fit.min_points, 2):
            continue
        distances = _chord_distances(piece)
        at = int(distances.argmax())
        if distances[at] <= fit.threshold_in or not 0 < at < len(piece) - 1:
            yield piece
        else:
            remaining += [piece[at:], piece[: at + 1]]


def _chord_distances(piece: FloatArray) -> FloatArray:
    """Return the distances of points from the line through the first and the last; from the first if these coincide."""
    chord, offsets = piece[-1] - piece[0], piece - piece[0]
    length = float(np.hypot(*chord))
    if length == 0.0:
        distances: FloatArray = np.hypot(offsets[:, 0], offsets[:, 1])
    else:
        distances = np.abs(chord[0] * offsets[:, 1] - chord[1] * offsets[:, 0]) / length
    return distances


def _fit_line(piece: FloatArray) -> FloatArray:
    """Return the line (4,) of least squared distances, between the projections of the first and the last point.

    Its direction is half the angle of (sum(u^2 - v^2), 2 sum(u v)), with u, v from the mean of the points (total least
    squares).
    """
    # Direction of the largest variance, then the ends of the piece projected onto it.
    mean = piece.mean(axis=0)
    u, v = (piece - mean).T
    angle = 0.5 * np.arctan2(2.0 * (u * v).sum(), (u * u - v * v).sum())
    along = np.array([np.cos(angle), np.sin(angle)])
    ends = mean + np.outer((piece[[0, -1]] - mean) @ along, along)
    line: FloatArray = ends.reshape(4)
    return line
