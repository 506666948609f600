"""The infrared ring of the N200: proximity in sixteen steps. Poses and time are passed in.

    reading = whole inches from the body, 0..15; 15 means nothing, and nothing is detected beyond 24 in in any case
    history h = 0..9: a reading is h tenths of the previous one and the rest the new one; more counts as 9

The whole ring flashes at once, every 60 ms (both this and the arithmetic of the history are assumptions: no source
gives them). As with the sonars a flash records its pose; rays are cast when a reading is used, which changes no value.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, inf
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.acoustics import MIN_FACTOR, NOISE_SIGMAS, relative_std
from nserver_emu.simulation.segments import NO_STAMP, PS_PER_S, TIME_MAX_PS, Stamp
from nserver_emu.simulation.settings import setting
from nserver_emu.simulation.visibility import SensorPose
from worlds.geometry import FloatArray, near_walls, normals
from worlds.raycast_arrays import cast_discs, cast_rays
from worlds.rings import evenly
from worlds.robots import Body

INFRAREDS: Final = 16
INFRARED_ANGLES_RAD: Final = evenly(INFRAREDS)
"""From the front of the turret; they do not depend on the sonars of a model."""
NOTHING: Final = 15
"""The reading without an obstacle."""
MAX_RANGE_IN: Final = 24.0
"""Nothing is detected beyond, whatever the calibration."""
TENTHS: Final = 10
MAX_HISTORY: Final = 9
"""With ten tenths of the previous reading, nothing new would ever be detected."""
INTERVAL_PS: Final = 60 * PS_PER_S // 1000
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
        return MAX_RANGE_IN / max(1.0 - NOISE_SIGMAS * self.range_std_relative, MIN_FACTOR)


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

    def __init__(
        self, body: Body, noise: InfraredNoise, walls: FloatArray, now_ps: int, rng: np.random.Generator
    ) -> None:
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
        if state.due_ps != TIME_MAX_PS and not now_ps <= state.due_ps <= now_ps + INTERVAL_PS:
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
        # The order ends at the first number that is not a sensor.
        end = next((at for at, number in enumerate(order) if not 0 <= number < INFRAREDS), len(order))
        self._order = tuple(order[:end])
        self._history = min(max(history, 0), MAX_HISTORY)
        self.due_ps = now_ps if self._order else TIME_MAX_PS

    def flash_due(self, sensor_pose: SensorPose, stamp: Stamp) -> None:
        """Flash at this pose."""
        self.due_ps += INTERVAL_PS
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
            level = min(float(ranges[number]), NOTHING) if ranges[number] <= MAX_RANGE_IN else float(NOTHING)
            level = float(floor(max(level, 0.0) + 0.5))
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
